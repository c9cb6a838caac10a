//! The keys of the section `ros`.

use super::section::section;
use crate::net::RosPlace;

section! {
    /// Topics of ROS 2 that the program publishes and takes. The options `--ros` and `--ros-domain`
    /// of `run`, and the variable `ROS_DOMAIN_ID`, set these keys.
    pub RosKeys {
        /// Endpoint of the router of `rmw_zenoh`, as zenoh writes it.
        router: String = "tcp/127.0.0.1:7447".to_owned();
        /// Number of the domain.
        domain: u32 = 0, 0.0..=232.0;
    }
}

impl RosKeys {
    /// Returns the place of the topics.
    #[must_use]
    pub fn place(&self) -> RosPlace {
        RosPlace { router: self.router.clone(), domain: self.domain }
    }
}
