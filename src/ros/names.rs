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

    /// Returns the token of the subscriber of a topic, the only one of its session. `hash` is that
    /// of the type `kind`. Drivers of cameras send nothing before they see one.
    #[must_use]
    pub fn subscriber(&self, topic: &str, kind: &str, hash: &str) -> String {
        let (domain, session) = (self.domain, &self.session);
        let (topic, of) = (topic.replace('/', "%"), dds_of(kind));
        format!("@ros2_lv/{domain}/{session}/0/1/MS/%/%/{NODE}/{topic}/{of}/{hash}/{QOS}")
    }
}

/// Returns the expression of all keys of a topic's data in a domain, whatever its type: a message
/// of another type is refused with its name instead of never arriving.
pub(super) fn of_any_type(domain: u32, topic: &str) -> String {
    format!("{domain}/{}/*/*", topic.trim_start_matches('/'))
}

/// Returns the name of the type in the key of a topic's data: `std_msgs/msg/String`; `None` if the
/// key has another form.
pub(super) fn type_in(key: &str) -> Option<String> {
    let (before, _hash) = key.rsplit_once('/')?;
    let (_, dds) = before.rsplit_once('/')?;
    let (package, name) = dds.strip_suffix('_')?.split_once("::dds_::")?;
    Some(format!("{}/{name}", package.replace("::", "/")))
}

/// Returns the name of a type in DDS: `std_msgs::msg::dds_::String_`.
fn dds_name(kind: Kind) -> String {
    dds_of(kind.name())
}

/// Returns the name in DDS of the type that ROS calls `name`.
fn dds_of(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => name.to_owned(),
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

/// Data that `rmw_zenoh` attaches to a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Attached {
    /// Number of the message, which counts those of its publisher.
    pub(super) number: u64,
    /// Time of its sending (ns since 1970).
    pub(super) time: u64,
    /// Identity of its publisher.
    pub(super) publisher: [u8; 16],
}

impl Attached {
    /// Reads an attachment; `None` if it has another form.
    pub(super) fn read(bytes: &[u8]) -> Option<Self> {
        let (number, rest) = bytes.split_first_chunk::<8>()?;
        let (time, rest) = rest.split_first_chunk::<8>()?;
        let (length, publisher) = rest.split_first()?;
        Some(Self {
            number: u64::from_le_bytes(*number),
            time: u64::from_le_bytes(*time),
            publisher: publisher.try_into().ok().filter(|_| *length == 16)?,
        })
    }
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
    fn subscriber_has_a_token() {
        let names = Names { domain: 2, session: "a1".into() };
        assert_eq!(
            names.subscriber("/camera/image", "sensor_msgs/msg/Image", "RIHS01_0"),
            "@ros2_lv/2/a1/0/1/MS/%/%/rubik_robot/%camera%image/sensor_msgs::msg::dds_::Image_/\
             RIHS01_0/::,10:,:,:,,"
        );
    }

    #[test]
    fn type_of_message_is_in_its_key() {
        let names = Names { domain: 7, session: String::new() };
        let key = names.data("/a/b", Kind::JointState);

        assert_eq!(type_in(&key).as_deref(), Some("sensor_msgs/msg/JointState"));
        assert_eq!(of_any_type(7, "/a/b"), "7/a/b/*/*");
        for other in ["", "7", "7/a", "7/a/b::C_/h", "7/a/b::dds_::C/h", "//"] {
            assert_eq!(type_in(other), None, "{other}");
        }
    }

    #[test]
    fn attachment_of_any_other_length_is_refused() {
        let bytes = attachment(3, 5, [7; 16]);
        let wanted = Attached { number: 3, time: 5, publisher: [7; 16] };

        assert_eq!(Attached::read(&bytes), Some(wanted));
        for length in 0..bytes.len() {
            assert_eq!(Attached::read(&bytes[..length]), None, "{length}");
        }
        assert_eq!(Attached::read(&[bytes.clone(), vec![0]].concat()), None);
        let mut other = bytes;
        other[16] = 15;
        assert_eq!(Attached::read(&other), None);
    }

    #[test]
    fn attachment_has_number_time_and_identity() {
        let bytes = attachment(3, 0x0102, [7; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!((bytes[0], bytes[8], bytes[9], bytes[16], bytes[32]), (3, 2, 1, 16, 7));
    }
}
