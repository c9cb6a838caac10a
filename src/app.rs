//! The program of a user: the command line with tasks of his own beside those of this crate.

use crate::cli;
use crate::generators::own::MotionGenerator;
use crate::kernel::programme::EcpTask;
use crate::registry::{DeviceModel, Registry, Sensor, Task, Verdict};
use crate::scenario::maker::Maker;
use crate::tasks;
use std::process::ExitCode;

/// A program with the whole command line: runs, page, recordings, faults, campaigns and replay.
///
/// ```
/// use rubik_robot::App;
/// use std::process::ExitCode;
///
/// /// Makes the program: the tasks of this crate, in recordings under another name.
/// fn program() -> App {
///     App::new().named("my-robot", "0.1.0")
/// }
///
/// /// Runs the program; a `main` needs nothing else.
/// fn main_of_program() -> ExitCode {
///     program().main()
/// }
///
/// assert!(format!("{:?}", program()).contains("my-robot"));
/// ```
#[derive(Debug)]
pub struct App {
    registry: Registry,
    program: Maker,
}

impl Default for App {
    fn default() -> Self {
        Self { registry: tasks::built_in(), program: Maker::default() }
    }
}

impl App {
    /// Makes a program with the tasks of this crate.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Names the program in its recordings, journals and campaigns: other programs refuse them by
    /// this name. It is usually that of the package, `env!("CARGO_PKG_NAME")` and
    /// `env!("CARGO_PKG_VERSION")`.
    #[must_use]
    pub fn named(mut self, name: &str, version: &str) -> Self {
        name.clone_into(&mut self.program.program);
        version.clone_into(&mut self.program.version);
        self
    }

    /// Adds a task, which scenarios call `name`; a task of the same name is replaced.
    #[must_use]
    pub fn task<T: Task>(mut self, name: &'static str) -> Self {
        self.registry = self.registry.task::<T>(name);
        self
    }

    /// Gives the task that was added last a judge. Without one the task is believed.
    #[must_use]
    pub fn verdict<V: Verdict>(mut self) -> Self {
        self.registry = self.registry.verdict::<V>();
        self
    }

    /// Adds a sensor, which `[[vsp]]` of a scenario names by `kind = "name"`; one of the same name
    /// is replaced.
    #[must_use]
    pub fn sensor<S: Sensor>(mut self, name: &'static str) -> Self {
        self.registry = self.registry.sensor::<S>(name);
        self
    }

    /// Gives a sensor that was added before a model of its device. Without one a simulated run uses
    /// the real device.
    #[must_use]
    pub fn simulated<D: DeviceModel>(mut self) -> Self {
        self.registry = self.registry.simulated::<D>();
        self
    }

    /// Adds a programme of an ECP, which kernels of MP start by `name`.
    #[must_use]
    pub fn programme<P: EcpTask>(mut self, name: &'static str) -> Self {
        self.registry = self.registry.programme::<P>(name);
        self
    }

    /// Adds a motion generator, which tasks order by `name`; one of the same name is replaced.
    #[must_use]
    pub fn generator<G: MotionGenerator>(mut self, name: &'static str) -> Self {
        self.registry = self.registry.generator::<G>(name);
        self
    }

    /// Reads the arguments of the process, carries out the command and returns the exit code.
    #[must_use]
    pub fn main(self) -> ExitCode {
        let mut catalogue = self.registry.catalogue();
        catalogue.program = self.program;
        cli::main(catalogue)
    }
}
