//! `run --ros`: publishes the topics of ROS 2 while a run goes on.

use super::output::refuse;
use crate::record::feed::Feed;
use crate::ros::Publisher;
use clap::Args;

/// Endpoint of the router of `rmw_zenoh` on this machine.
const ROUTER: &str = "tcp/127.0.0.1:7447";

/// Options of the topics of ROS 2.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Args)]
pub(super) struct RosArgs {
    /// Publish topics of ROS 2 over the router of rmw_zenoh at ENDPOINT
    /// [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, require_equals = true,
          default_missing_value = ROUTER, verbatim_doc_comment)]
    pub(super) ros: Option<String>,
    /// Domain of the topics [default: that of ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", requires = "ros")]
    ros_domain: Option<u32>,
}

impl RosArgs {
    /// Begins to publish a feed; `None` without `--ros`.
    pub(super) fn publish(&self, feed: Feed) -> Option<anyhow::Result<Publisher>> {
        let router = self.ros.as_ref()?;
        let domain = match self.domain() {
            Ok(domain) => domain,
            Err(why) => return Some(Err(refuse(why))),
        };
        Some(Publisher::start(feed, router, domain).map_err(|why| refuse(format!("--ros: {why}"))))
    }

    /// Returns the domain of the option, or else of the environment.
    fn domain(&self) -> Result<u32, String> {
        if let Some(domain) = self.ros_domain {
            return Ok(domain);
        }
        match std::env::var("ROS_DOMAIN_ID") {
            Err(_) => Ok(0),
            Ok(text) => text.parse().map_err(|_| format!("ROS_DOMAIN_ID: \"{text}\" is no number")),
        }
    }
}
