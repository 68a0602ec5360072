/// How the next touch is chosen among the candidates of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Policy {
    /// The largest expected gain.
    NextBest,
    /// The first: candidates are drawn area-uniformly.
    Random,
    /// The farthest from all touches so far.
    Even,
    /// Tries every candidate on the truth and keeps the one that lowers the true error most. A yardstick: no robot can do this.
    Oracle,
}

impl Policy {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::NextBest, Self::Random, Self::Even, Self::Oracle];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::NextBest => "next-best",
            Self::Random => "random",
            Self::Even => "even",
            Self::Oracle => "oracle",
        }
    }
}
