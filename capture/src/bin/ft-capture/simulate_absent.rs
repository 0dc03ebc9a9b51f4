//! `ft-capture --sim` in a build without the feature `sim`.

use ft_capture::summary::Summary;

use crate::RecordArguments;

/// Whether an error is one of the command line.
pub(crate) fn is_wrong_argument(_error: &(dyn std::error::Error + 'static)) -> bool {
    false
}

/// Says that this build cannot.
pub(crate) fn run(
    _arguments: &RecordArguments,
    name: &str,
) -> Result<Summary, Box<dyn std::error::Error>> {
    Err(format!("--sim {name}: this program was built without the feature `sim`").into())
}
