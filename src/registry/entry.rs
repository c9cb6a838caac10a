//! A registered task with its type erased: what a scenario and a run need of it.
//!
//! - in: the types of a task and of its judge
//! - out: functions that read its journal, make its kernel, have MP perform it and judge it

use super::task::{Earlier, EntryOf, Setup, Task};
use super::verdict::{Beginning, Judgement, Truth, Verdict};
use crate::actors::mp::{Ending, Mp};
use crate::hw::plant::Plant;
use crate::kernel::{Account, JournalEntry, Kernel};
use crate::motion::ArmState;
use crate::reach::MeetingTable;
use crate::record::journal::Journal;
use crate::scenario::ControllerConfig;
use crate::scenario::catalogue::Declaration;
use crate::scenario::declared::{Keys, Properties};
use crate::scenario::maker::Maker;
use crate::scenario::section::Reader;
use std::any::Any;
use std::fmt;
use std::path::Path;
use std::pin::Pin;

/// Kernel of a registered task, of any type.
pub trait Registered: Send {
    /// Has MP perform the task to its end.
    fn perform<'a>(&'a mut self, mp: Mp) -> Pin<Box<dyn Future<Output = Ending> + 'a>>;
    /// Returns the kernel's account of the task.
    fn account(&self) -> Account;
    /// Corrects the account after an error, by the states of the arms at rest.
    fn look_back(&mut self, arms: &[ArmState]);
}

impl<K: Kernel> Registered for K {
    fn perform<'a>(&'a mut self, mp: Mp) -> Pin<Box<dyn Future<Output = Ending> + 'a>> {
        Box::pin(mp.run(self))
    }

    fn account(&self) -> Account {
        Kernel::account(self)
    }

    fn look_back(&mut self, arms: &[ArmState]) {
        Kernel::look_back(self, arms);
    }
}

/// Journal of a run, and the last entry of the run that it resumes.
#[derive(Default)]
pub struct Logbook {
    /// Journal of this run; `None` for a run without one.
    pub journal: Option<Journal>,
    /// Whether this run continues where another one was interrupted.
    resumes: bool,
    /// Last entry of that other run, and whether it was over; `None` if it had not begun.
    last: Option<(Box<dyn Any + Send>, bool)>,
}

impl fmt::Debug for Logbook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Logbook").field("resumes", &self.resumes).finish_non_exhaustive()
    }
}

impl Logbook {
    /// Opens the journal at `path` for entries of the type `E`. If the run `resumes` another one,
    /// the last entry of that run is read first.
    fn open<E: JournalEntry>(path: &Path, resumes: bool) -> Result<Self, String> {
        // The last entry is read before the file is opened for this run's own entries.
        let last =
            if resumes { Journal::last::<E>(path).map_err(|why| why.to_string())? } else { None };
        let journal = Journal::open::<E>(path, resumes).map_err(|why| why.to_string())?;
        let last = last.map(|last| {
            let is_over = last.is_over();
            (Box::new(last) as Box<dyn Any + Send>, is_over)
        });
        Ok(Self { journal: Some(journal), resumes, last })
    }

    /// Returns whether the interrupted run that this one resumes had written an entry.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        self.last.is_some()
    }

    /// Returns whether the run that this one resumes was interrupted before its end.
    #[must_use]
    pub fn is_broken_off(&self) -> bool {
        self.last.as_ref().is_some_and(|(_, is_over)| !is_over)
    }

    /// Takes the state in which the interrupted run left the task.
    fn earlier<E: 'static>(&mut self) -> Earlier<E> {
        match self.last.take().map(|(last, _)| last.downcast::<E>()) {
            Some(Ok(last)) => Earlier::Last(*last),
            _ if self.resumes => Earlier::NotBegun,
            _ => Earlier::None,
        }
    }
}

/// Makes a kernel from a configuration, whether there is an operator, the meetings and the journal.
type MakeKernel = fn(
    &TaskEntry,
    &ControllerConfig,
    bool,
    Option<MeetingTable>,
    &mut Logbook,
) -> Result<Box<dyn Registered>, String>;

/// Checks the keys of a task against the rest of a scenario.
type Check = fn(&mut dyn Keys, &ControllerConfig, &mut Reader);

/// Returns how the plant begins.
type Begin =
    fn(&TaskEntry, &ControllerConfig, Option<&MeetingTable>) -> Result<Option<Beginning>, String>;

/// Judge of a run, of any type.
pub trait Judge: Send {
    /// Looks at the plant after a servo period. `tick` is the time in periods of 2 ms.
    fn watch(&mut self, tick: u64, plant: &Plant);
    /// Judges the plant at the end of a run of this task.
    fn judge(&self, task: &TaskEntry, config: &ControllerConfig, truth: &Truth) -> Judgement;
}

impl<V: Verdict> Judge for V {
    fn watch(&mut self, tick: u64, plant: &Plant) {
        Verdict::watch(self, tick, plant);
    }

    fn judge(&self, task: &TaskEntry, config: &ControllerConfig, truth: &Truth) -> Judgement {
        Verdict::judge(self, &task.keys::<V::Task>(config), truth)
    }
}

/// Facts about the judge of a registered task.
#[derive(Clone, Copy)]
struct Judged {
    /// Time that the world needs after a success (s).
    settles: f64,
    begin: Begin,
    judge: fn() -> Box<dyn Judge>,
}

/// A registered task.
#[derive(Clone)]
pub struct TaskEntry {
    name: &'static str,
    section: &'static str,
    properties: Properties,
    defaults: fn() -> Box<dyn Keys>,
    check: Check,
    open: fn(&Path, bool) -> Result<Logbook, String>,
    kernel: MakeKernel,
    judged: Option<Judged>,
}

impl fmt::Debug for TaskEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let judged = self.judged.is_some();
        let mut entry = f.debug_struct("TaskEntry");
        entry.field("name", &self.name).field("judged", &judged).finish_non_exhaustive()
    }
}

impl TaskEntry {
    /// Makes the entry of a task that scenarios call `name`, without a judge.
    pub(super) fn of<T: Task>(name: &'static str) -> Self {
        Self {
            name,
            section: T::SECTION.unwrap_or(name),
            properties: T::PROPERTIES,
            defaults: || Box::new(T::Keys::default()),
            check: |keys, config, reader| {
                if let Some(keys) = keys.as_any_mut().downcast_mut::<T::Keys>() {
                    T::check(keys, config, reader);
                }
            },
            open: Logbook::open::<EntryOf<T>>,
            kernel: |entry, config, has_operator, meetings, logbook| {
                let keys = &entry.keys::<T>(config);
                let earlier = logbook.earlier();
                let setup = Setup { keys, config, has_operator, earlier, meetings };
                Ok(Box::new(T::kernel(setup)?))
            },
            judged: None,
        }
    }

    /// Gives the task a judge.
    pub(super) fn judged_by<V: Verdict>(&mut self) {
        self.judged = Some(Judged {
            settles: V::SETTLES,
            begin: |entry, config, meetings| {
                V::beginning(&entry.keys::<V::Task>(config), config, meetings)
            },
            judge: || Box::new(V::default()),
        });
    }

    /// Returns the entry of a declared task; `None` if no registry made the declaration.
    #[must_use]
    pub fn of_declaration(declaration: &dyn Declaration) -> Option<&Self> {
        declaration.as_any().downcast_ref()
    }

    /// Returns the keys of this task in a scenario, or else the defaults.
    fn keys<T: Task>(&self, config: &ControllerConfig) -> T::Keys {
        config.sections.get::<T::Keys>(self.section).cloned().unwrap_or_default()
    }

    /// Opens the journal of a run at `path`, which is to name the `program`.
    ///
    /// # Errors
    /// If the journal cannot be read or written, is that of another program, or holds an unfinished
    /// run that is not resumed.
    pub fn open(&self, path: &Path, resumes: bool, program: &Maker) -> Result<Logbook, String> {
        Journal::check_maker(path, program).map_err(|why| why.to_string())?;
        let mut logbook = (self.open)(path, resumes)?;
        // A journal that goes on has its first line already, or is of an older version.
        if let Some(journal) = logbook.journal.as_mut().filter(|_| logbook.last.is_none()) {
            journal.sign(program, self.name).map_err(|why| why.to_string())?;
        }
        Ok(logbook)
    }

    /// Makes the kernel. `has_operator` is whether an operator can be asked.
    ///
    /// # Errors
    /// The reason why the cell does not allow the task.
    pub fn kernel(
        &self,
        config: &ControllerConfig,
        has_operator: bool,
        meetings: Option<MeetingTable>,
        logbook: &mut Logbook,
    ) -> Result<Box<dyn Registered>, String> {
        (self.kernel)(self, config, has_operator, meetings, logbook)
    }

    /// Returns how the plant begins, if not as the scenario says.
    ///
    /// # Errors
    /// The reason why the cell allows no such beginning.
    pub fn beginning(
        &self,
        config: &ControllerConfig,
        meetings: Option<&MeetingTable>,
    ) -> Result<Option<Beginning>, String> {
        self.judged.map_or(Ok(None), |judged| (judged.begin)(self, config, meetings))
    }

    /// Returns the time that the world needs after a success before it can be judged (s).
    #[must_use]
    pub fn settles(&self) -> f64 {
        self.judged.map_or(0.0, |judged| judged.settles)
    }

    /// Makes the judge of a run; `None` for a task without one, which is believed.
    #[must_use]
    pub fn judge(&self) -> Option<Box<dyn Judge>> {
        self.judged.map(|judged| (judged.judge)())
    }
}

impl Declaration for TaskEntry {
    fn name(&self) -> &'static str {
        self.name
    }

    fn section(&self) -> &'static str {
        self.section
    }

    fn defaults(&self) -> Box<dyn Keys> {
        (self.defaults)()
    }

    fn properties(&self) -> Properties {
        self.properties
    }

    fn check(&self, keys: &mut dyn Keys, config: &ControllerConfig, reader: &mut Reader) {
        (self.check)(keys, config, reader);
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
