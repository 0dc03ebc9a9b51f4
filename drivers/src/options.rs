//! Choices that several devices share.

/// What a driver does before samples flow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Startup {
    /// Stop what may still stream, drain, identify, configure, start.
    #[default]
    Configure,
    /// Send nothing and read what comes: for a device that another program set up, and for replayed recordings.
    Listen,
}

/// Which side's wrench a sensor reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sign {
    /// Environment on tool, as recordings hold it: taken over as it comes.
    #[default]
    EnvironmentOnTool,
    /// Tool on environment: every component is negated.
    ToolOnEnvironment,
}

impl Sign {
    /// Applies the sign to a wrench as the sensor reported it.
    #[must_use]
    pub fn apply<F>(self, reported: ft_wire::Wrench<F>) -> ft_wire::Wrench<F> {
        match self {
            Self::EnvironmentOnTool => reported,
            Self::ToolOnEnvironment => reported.flipped(),
        }
    }
}
