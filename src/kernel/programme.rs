//! Programmes: kernels of the ECPs, which MP starts.
//!
//! The kernel of a programme is one of the same kind as that of MP, but over one effector, which it
//! knows as effector 0. It may neither ask the operator nor think long. MP may exchange signals
//! with programmes, wait for their ends, or do nothing while they run.
//!
//! - in: a [`Programme`], plain data: the registered name of the kernel, and its order
//! - out: the kernel

use super::message::Programme;
use super::{Kernel, Progress};
use serde::de::DeserializeOwned;
use serde::{Deserialize as _, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// Kernel of an ECP.
pub type EcpKernel = Box<dyn Kernel<Thought = (), Entry = Progress>>;

/// A programme that MP can start on an effector.
pub trait EcpTask: 'static {
    /// Order at the start of the programme; plain data.
    type Order: Serialize + DeserializeOwned;
    /// Kernel that carries the order out.
    type Kernel: Kernel<Thought = (), Entry = Progress> + 'static;

    /// Makes the kernel.
    fn kernel(order: Self::Order) -> Self::Kernel;

    /// Makes the order to begin this programme, which is registered as `name`.
    ///
    /// # Errors
    /// If the order has no form in JSON.
    fn programme(name: &str, order: &Self::Order) -> Result<Programme, String> {
        let order = serde_json::to_value(order).map_err(|why| why.to_string())?;
        Ok(Programme { name: name.to_owned(), order })
    }
}

/// Makes the kernel of a programme from its order.
type Make = fn(&Value) -> Result<EcpKernel, String>;

/// Programmes that are registered, by name.
#[derive(Clone, Default)]
pub struct Programmes(Arc<BTreeMap<&'static str, Make>>);

impl PartialEq for Programmes {
    fn eq(&self, other: &Self) -> bool {
        self.0.keys().eq(other.0.keys())
    }
}

impl fmt::Debug for Programmes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.0.keys()).finish()
    }
}

impl Programmes {
    /// Adds the programme `P` under this name; one of the same name is replaced.
    pub fn register<P: EcpTask>(&mut self, name: &'static str) {
        let make: Make = |order| {
            let order = P::Order::deserialize(order).map_err(|why| why.to_string())?;
            Ok(Box::new(P::kernel(order)))
        };
        Arc::make_mut(&mut self.0).insert(name, make);
    }

    /// Makes the kernel of a programme.
    ///
    /// # Errors
    /// If no programme has this name, or its order cannot be read.
    pub fn kernel(&self, programme: &Programme) -> Result<EcpKernel, String> {
        let name = &programme.name;
        let make = self.0.get(name.as_str()).ok_or_else(|| {
            let known: Vec<&str> = self.0.keys().copied().collect();
            format!("there is no programme `{name}`; known: {}", known.join(", "))
        })?;
        make(&programme.order).map_err(|why| format!("order of the programme `{name}`: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::robot::{Robot, RobotKernel};

    /// Programme that ends with the text of its order.
    struct Says;

    impl EcpTask for Says {
        type Order = String;
        type Kernel = RobotKernel;

        fn kernel(order: String) -> RobotKernel {
            Robot::kernel(|_| async move { Ok(order) })
        }
    }

    #[test]
    fn unknown_programme_or_order_is_refused_by_name() {
        let mut programmes = Programmes::default();
        programmes.register::<Says>("says");
        let refusal = |name: &str, order: Value| {
            let programme = Programme { name: name.to_owned(), order };
            programmes.kernel(&programme).err().unwrap_or_default()
        };

        let good = Says::programme("says", &"done".to_owned()).unwrap();
        assert_eq!(refusal(&good.name, good.order), "");
        assert_eq!(refusal("sings", Value::Null), "there is no programme `sings`; known: says");
        let wrong = refusal("says", Value::from(3));
        assert!(wrong.starts_with("order of the programme `says`: "), "{wrong}");
    }
}
