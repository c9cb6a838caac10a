//! The trait of a task, and the parts from which its kernel is made.

use crate::kernel::Kernel;
use crate::reach::MeetingTable;
use crate::scenario::ControllerConfig;
use crate::scenario::declared::Properties;
use crate::scenario::section::{Reader, Section};
use std::fmt::Debug;

/// A task that a scenario can name: the kernel of MP, and the keys that it reads.
pub trait Task: Sized + 'static {
    /// Keys of the task, which the macro [`section!`](crate::section) declares.
    type Keys: Section + Clone + Debug + Send + Sync + 'static;
    /// Kernel of MP.
    type Kernel: Kernel + 'static;
    /// Name of the section of its keys in a scenario; that of the task if `None`. Tasks with the
    /// same type of keys may share a section.
    const SECTION: Option<&'static str> = None;
    /// Properties that decide how a run begins.
    const PROPERTIES: Properties = Properties::PLAIN;

    /// Checks whether the cell has what the task needs, and whether its keys agree with the rest of
    /// the scenario. Faults go to `reader`, each with the dotted name of the key that must change.
    fn check(keys: &mut Self::Keys, config: &ControllerConfig, reader: &mut Reader) {
        let _ = (keys, config, reader);
    }

    /// Makes the kernel. `check` does this as well, and a run more than once, so it must change
    /// nothing outside of the kernel.
    ///
    /// # Errors
    /// The reason why the cell does not allow the task.
    fn kernel(setup: Setup<'_, Self>) -> Result<Self::Kernel, String>;
}

/// Journal entry of a task.
pub type EntryOf<T> = <<T as Task>::Kernel as Kernel>::Entry;

/// All that a kernel is made from.
#[derive(Debug)]
pub struct Setup<'a, T: Task> {
    /// Keys of the task.
    pub keys: &'a T::Keys,
    /// Controller's half of the scenario.
    pub config: &'a ControllerConfig,
    /// Whether an operator can be asked.
    pub has_operator: bool,
    /// State in which an interrupted run left the task.
    pub earlier: Earlier<EntryOf<T>>,
    /// Meetings of the hands of the first two arms; `None` for a cell of one.
    pub meetings: Option<MeetingTable>,
}

/// State in which an interrupted run left a task, by its journal.
#[derive(Debug)]
pub enum Earlier<E> {
    /// The run continues no other one.
    None,
    /// The other run had not begun.
    NotBegun,
    /// Last entry of the other run.
    Last(E),
}
