//! The options of topics of ROS 2: where `run` publishes and takes them.

use super::output::refuse;
use crate::net::domain_of_environment;
use crate::record::feed::Feed;
use crate::ros::Publisher;
use crate::scenario::ros_keys::RosKeys;
use clap::Args;

/// Options of the topics of ROS 2.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Args)]
pub(super) struct RosArgs {
    /// Publish topics of ROS 2 over the router of rmw_zenoh at ENDPOINT
    /// [default: ros.router of the scenario, tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, require_equals = true,
          default_missing_value = "", verbatim_doc_comment)]
    pub(super) ros: Option<String>,
    /// Domain of the topics [default: that of ROS_DOMAIN_ID, or ros.domain of the
    /// scenario, 0]
    #[arg(long, value_name = "N", verbatim_doc_comment,
          value_parser = clap::value_parser!(u32).range(0..=232))]
    ros_domain: Option<u32>,
}

impl RosArgs {
    /// Sets the keys of a scenario that the options and the environment name.
    ///
    /// # Errors
    /// If the environment names a domain that is no number.
    pub(super) fn set(&self, keys: &mut RosKeys) -> anyhow::Result<()> {
        if let Some(router) = self.ros.as_ref().filter(|router| !router.is_empty()) {
            keys.router.clone_from(router);
        }
        let domain = match self.ros_domain {
            Some(domain) => Some(domain),
            None => domain_of_environment().map_err(refuse)?,
        };
        keys.domain = domain.unwrap_or(keys.domain);
        Ok(())
    }

    /// Begins to publish a feed at the place of these keys; `None` without `--ros`.
    pub(super) fn publish(&self, keys: &RosKeys, feed: Feed) -> Option<anyhow::Result<Publisher>> {
        self.ros.as_ref()?;
        let publisher = Publisher::start(feed, &keys.place());
        Some(publisher.map_err(|why| refuse(format!("--ros: {why}"))))
    }
}
