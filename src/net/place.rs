//! Topics of ROS 2 to which the program subscribes: their place, which is a router of `rmw_zenoh`
//! and the number of a domain, and the form of their names.

/// Variable of the environment that has the domain, as for all programs of ROS 2.
const VARIABLE: &str = "ROS_DOMAIN_ID";

/// Router and domain of topics.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RosPlace {
    /// Endpoint of the router, as zenoh writes it.
    pub router: String,
    /// Number of the domain.
    pub domain: u32,
}

/// Returns the domain that the environment names; `None` if it names none.
///
/// # Errors
/// The reason, if the variable has no number.
pub fn domain_of_environment() -> Result<Option<u32>, String> {
    match std::env::var(VARIABLE) {
        Err(_) => Ok(None),
        Ok(text) => {
            let number = text.parse().map_err(|_| format!("{VARIABLE}: \"{text}\" is no number"));
            number.map(Some)
        }
    }
}

/// Returns the reason why a name cannot be that of a topic to which the program subscribes; `None`
/// if it can. Wildcards of zenoh are refused: two topics must not pass for one.
#[must_use]
pub fn refuses_topic(name: &str) -> Option<String> {
    let allowed = |part: &str| {
        let mut letters = part.chars();
        letters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_')
            && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    let parts = name.strip_prefix('/').filter(|name| name.len() <= 255);
    let right = parts.is_some_and(|parts| parts.split('/').all(allowed));
    (!right)
        .then(|| format!("\"{name}\" is no full name of a topic, such as \"/camera/image_raw\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_with_wildcards_are_refused() {
        for right in ["/a", "/_a1/B_2"] {
            assert_eq!(refuses_topic(right), None, "{right}");
        }
        let long = format!("/{}", "a".repeat(300));
        for wrong in ["", "/", "a", "/a/", "/*", "/a/**", "/a//b", "/1a", "/a b", "/a$", &long] {
            assert!(refuses_topic(wrong).is_some(), "{wrong}");
        }
    }
}
