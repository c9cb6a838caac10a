//! Names under which `rmw_zenoh` finds topics: keys of the data, tokens of nodes and publishers,
//! and what is attached to each message.

use super::type_hash::type_hash;
use crate::record::schema::Kind;

/// Name of our node.
const NODE: &str = "rubik_robot";
/// Quality of service of all topics: the defaults, which are reliable, volatile, and keep the last
/// ten messages.
const QOS: &str = "::,10:,:,:,,";

/// Names of the topics of one session.
#[derive(Debug, Clone)]
pub struct Names {
    /// Number of the domain, as `ROS_DOMAIN_ID` has it.
    pub domain: u32,
    /// Identity of the session.
    pub session: String,
}

impl Names {
    /// Returns the key of a topic's data.
    #[must_use]
    pub fn data(&self, topic: &str, kind: Kind) -> String {
        let topic = topic.trim_start_matches('/');
        format!("{}/{topic}/{}/{}", self.domain, dds_name(kind), type_hash(kind))
    }

    /// Returns the token of the node.
    #[must_use]
    pub fn node(&self) -> String {
        format!("@ros2_lv/{}/{}/0/0/NN/%/%/{NODE}", self.domain, self.session)
    }

    /// Returns the token of the publisher of a topic, which is the `number`th of the node.
    #[must_use]
    pub fn publisher(&self, number: u32, topic: &str, kind: Kind) -> String {
        let (domain, session) = (self.domain, &self.session);
        let (topic, of, hash) = (topic.replace('/', "%"), dds_name(kind), type_hash(kind));
        format!("@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/{NODE}/{topic}/{of}/{hash}/{QOS}")
    }
}

/// Returns the name of a type in DDS: `std_msgs::msg::dds_::String_`.
fn dds_name(kind: Kind) -> String {
    match kind.name().rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => kind.name().to_owned(),
    }
}

/// Returns what is attached to a message: its number, the time of its sending (ns since 1970), and
/// the identity of its publisher.
pub(super) fn attachment(number: u64, time: u64, publisher: [u8; 16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(33);
    bytes.extend(number.to_le_bytes());
    bytes.extend(time.to_le_bytes());
    bytes.push(16);
    bytes.extend(publisher);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the design document of `rmw_zenoh`.
    #[test]
    fn names_follow_the_design_document() {
        let names = Names { domain: 0, session: "aac3178e146ba6f1fc6e6a4085e77f21".into() };

        assert_eq!(
            names.data("/chatter", Kind::Text),
            "0/chatter/std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
        );
        assert_eq!(
            names.node(),
            "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/rubik_robot"
        );
        assert_eq!(
            names.publisher(10, "/chatter", Kind::Text),
            "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/rubik_robot/%chatter/\
             std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,10:,:,:,,"
        );
    }

    #[test]
    fn attachment_has_number_time_and_identity() {
        let bytes = attachment(3, 0x0102, [7; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!((bytes[0], bytes[8], bytes[9], bytes[16], bytes[32]), (3, 2, 1, 16, 7));
    }
}
