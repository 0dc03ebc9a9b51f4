//! `ft-capture keys`.

use std::path::PathBuf;

use clap::Args;
use ft_capture::keys::{self, Proof, Roles};

use crate::terminal::say;
use crate::{CommandResult, Outcome};

const EXAMPLES: &str = "Examples:
  ft-capture keys -o keys --host 192.168.0.7                       certificates for one operator and one viewer
  ft-capture keys -o keys --host gripper.local --operator anna --operator eva --viewer lab
  ft-capture keys -o keys --host 192.168.0.7 --passwords           only the capture has a certificate, the others a password

Then, on the capture: ft-capture --keys keys/capture --listen tls/0.0.0.0:7447
and on the others, with their own folder: ft-view --keys viewer --connect tls/192.168.0.7:7447

Operators may command, viewers only look. Keys do not expire; who is to be added or shut out needs new keys for all.";

/// What to make.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct KeysArguments {
    /// The new folder
    #[arg(short, long, value_name = "DIR", default_value = "keys")]
    output: PathBuf,
    /// Name or address by which the capture is reached
    #[arg(long, value_parser = host)]
    host: Vec<String>,
    /// Port on which the capture will listen: for the commands that are printed, the keys are the same for all
    #[arg(long, value_name = "PORT", default_value_t = 7447, value_parser = clap::value_parser!(u16).range(1..))]
    port: u16,
    /// Who may look and command [default: operator]
    #[arg(long, value_name = "NAME")]
    operator: Vec<String>,
    /// Who may only look [default: viewer]
    #[arg(long, value_name = "NAME")]
    viewer: Vec<String>,
    /// Passwords for viewers and operators instead of certificates
    #[arg(long)]
    passwords: bool,
}

fn host(text: &str) -> Result<String, String> {
    if keys::is_host(text) {
        Ok(text.to_owned())
    } else {
        Err("a name like gripper.local or an address like 192.168.0.7".to_owned())
    }
}

/// Carries the command out.
pub(crate) fn run(arguments: &KeysArguments) -> CommandResult {
    let or_default = |names: &[String], default: &str| match names {
        [] => vec![default.to_owned()],
        names => names.to_vec(),
    };
    let roles = Roles {
        proof: if arguments.passwords {
            Proof::Password
        } else {
            Proof::Certificate
        },
        operators: or_default(&arguments.operator, "operator"),
        viewers: or_default(&arguments.viewer, "viewer"),
    };
    keys::make(&arguments.output, &arguments.host, &roles)?;
    let folder = arguments.output.display();
    let port = arguments.port;
    let host = arguments.host.first().map_or("127.0.0.1", String::as_str);
    say(&format!(
        "capture: ft-capture --keys {folder}/capture --listen tls/0.0.0.0:{port}"
    ))?;
    for name in roles.operators.iter().chain(&roles.viewers) {
        say(&format!(
            "{name}: take {folder}/{name} there, then ft-view --keys {name} --connect tls/{host}:{port}"
        ))?;
    }
    Ok(Outcome::Fine)
}
