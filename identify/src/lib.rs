//! Joint, dynamics and what the model lacks, identified from a recording.
