//! Keys for an encrypted network: who is the capture, who may command, who may only look.
//!
//! ```text
//! DIR/capture/   ca.pem certificate.pem key.pem roles.toml [users.txt]    for `ft-capture --keys DIR/capture`
//! DIR/<name>/    ca.pem, certificate.pem key.pem | login.toml             for `ft-view --keys DIR/<name>`
//! ```
//!
//! Either everybody has a certificate (TLS both ways), or viewers and operators have a password and only the capture a
//! certificate. The authority's own key is not kept: who is to be added needs new keys for all.

use std::fs;
use std::io::Write as _;
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa,
    KeyPair, KeyUsagePurpose,
};
use serde::{Deserialize, Serialize};

use crate::config::is_name;
use crate::web::new_token;

/// How viewers and operators say who they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Proof {
    /// By a certificate of their own.
    Certificate,
    /// By a name and a password, over TLS.
    Password,
}

/// Who may do what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roles {
    /// How they say who they are.
    pub proof: Proof,
    /// May look and command.
    pub operators: Vec<String>,
    /// May look.
    pub viewers: Vec<String>,
}

/// Name and password of one viewer or operator.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// Name.
    pub user: String,
    /// Password.
    pub password: String,
}

/// Why there are no keys, or why they cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{}: {source}", path.display())]
    Syntax {
        /// Which file.
        path: PathBuf,
        /// Where and what.
        source: Box<toml::de::Error>,
    },
    /// The capture's own keys are no viewer's.
    #[error("{}: the capture's own; a viewer takes the folder of its name beside it", path.display())]
    OfCapture {
        /// Which folder.
        path: PathBuf,
    },
    /// A name cannot be a folder's, or is there twice.
    #[error("{name:?}: names are letters, digits, - and _, each one once, and not \"capture\"")]
    Name {
        /// The name.
        name: String,
    },
    /// A host is neither a name nor an address.
    #[error("a certificate cannot be made: {0}; hosts look like gripper.local or 192.168.0.7")]
    Certificate(#[from] rcgen::Error),
    /// The system has no randomness.
    #[error("no password could be made: {0}")]
    Randomness(getrandom::Error),
    /// What was made cannot be written as TOML.
    #[error("roles cannot be written: {0}")]
    Toml(#[from] toml::ser::Error),
}

/// Makes the keys of a capture that is reached as `hosts`, in the new folder `folder`.
///
/// # Errors
/// A name or host makes no sense, the folder exists, or it cannot be written.
pub fn make(folder: &Path, hosts: &[String], roles: &Roles) -> Result<(), KeyError> {
    let people: Vec<_> = roles.operators.iter().chain(&roles.viewers).collect();
    for (index, name) in people.iter().enumerate() {
        let twice = people.iter().take(index).any(|other| other == name);
        if !is_name(name) || *name == "capture" || twice {
            return Err(KeyError::Name {
                name: (*name).clone(),
            });
        }
    }
    let mut params = CertificateParams::new(Vec::new())?;
    params
        .distinguished_name
        .push(DnType::CommonName, "ForceTwin capture network");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let authority = CertifiedIssuer::self_signed(params, KeyPair::generate()?)?;

    new_folder(folder)?;
    let capture = folder.join("capture");
    let mut names: Vec<String> = hosts.to_vec();
    for local in ["localhost", "127.0.0.1", "::1"] {
        if !names.iter().any(|name| name == local) {
            names.push(local.to_owned());
        }
    }
    write_certificate(&capture, "capture", names, &authority)?;
    write_secret(&capture.join("roles.toml"), &toml::to_string(roles)?)?;
    let mut users = String::new();
    for name in people {
        let own = folder.join(name);
        match roles.proof {
            Proof::Certificate => write_certificate(&own, name, Vec::new(), &authority)?,
            Proof::Password => {
                let login = Login {
                    user: name.clone(),
                    password: new_token().map_err(KeyError::Randomness)?,
                };
                users += &format!("{}:{}\n", login.user, login.password);
                new_folder(&own)?;
                write_secret(&own.join("ca.pem"), &authority.pem())?;
                write_secret(&own.join("login.toml"), &toml::to_string(&login)?)?;
            }
        }
    }
    if roles.proof == Proof::Password {
        write_secret(&capture.join("users.txt"), &users)?;
    }
    Ok(())
}

fn write_certificate(
    folder: &Path,
    name: &str,
    hosts: Vec<String>,
    authority: &CertifiedIssuer<'_, KeyPair>,
) -> Result<(), KeyError> {
    let mut params = CertificateParams::new(hosts)?;
    params.distinguished_name.push(DnType::CommonName, name);
    params.use_authority_key_identifier_extension = true;
    params.extended_key_usages = vec![
        ExtendedKeyUsagePurpose::ServerAuth,
        ExtendedKeyUsagePurpose::ClientAuth,
    ];
    let key = KeyPair::generate()?;
    let certificate = params.signed_by(&key, authority)?;
    new_folder(folder)?;
    write_secret(&folder.join("ca.pem"), &authority.pem())?;
    write_secret(&folder.join("certificate.pem"), &certificate.pem())?;
    write_secret(&folder.join("key.pem"), &key.serialize_pem())
}

fn new_folder(folder: &Path) -> Result<(), KeyError> {
    fs::DirBuilder::new()
        .mode(0o700)
        .create(folder)
        .map_err(|source| KeyError::Io {
            path: folder.to_owned(),
            source,
        })
}

fn write_secret(path: &Path, text: &str) -> Result<(), KeyError> {
    fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .map_err(|source| KeyError::Io {
            path: path.to_owned(),
            source,
        })
}

/// Reads `roles.toml` of a capture's keys.
///
/// # Errors
/// It is not there, or not what it should be.
pub fn read_roles(folder: &Path) -> Result<Roles, KeyError> {
    read_toml(&folder.join("roles.toml"))
}

/// Reads `login.toml` of a viewer's keys; `None` when it has a certificate instead.
///
/// # Errors
/// It cannot be read, or is not what it should be.
pub fn read_login(folder: &Path) -> Result<Option<Login>, KeyError> {
    let path = folder.join("login.toml");
    if path.exists() {
        read_toml(&path).map(Some)
    } else {
        Ok(None)
    }
}

/// Whether `folder` has what a viewer shows: Zenoh itself would only wait in vain for a capture to answer.
///
/// # Errors
/// It has not.
pub fn check_of_viewer(folder: &Path) -> Result<(), KeyError> {
    let path = folder.join("ca.pem");
    match fs::metadata(&path) {
        Ok(_) if folder.join("roles.toml").exists() => Err(KeyError::OfCapture {
            path: folder.to_owned(),
        }),
        Ok(_) => Ok(()),
        Err(source) => Err(KeyError::Io { path, source }),
    }
}

fn read_toml<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, KeyError> {
    let text = fs::read_to_string(path).map_err(|source| KeyError::Io {
        path: path.to_owned(),
        source,
    })?;
    toml::from_str(&text).map_err(|source| KeyError::Syntax {
        path: path.to_owned(),
        source: Box::new(source),
    })
}

/// Whether `host` can stand in a certificate.
#[must_use]
pub fn is_host(host: &str) -> bool {
    host.parse::<IpAddr>().is_ok()
        || (!host.is_empty()
            && host
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-')))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    fn roles(proof: Proof) -> Roles {
        Roles {
            proof,
            operators: vec!["anna".to_owned()],
            viewers: vec!["bob".to_owned()],
        }
    }

    #[test]
    fn nobody_else_can_read_what_was_made() {
        let parent = tempfile::tempdir().unwrap();
        for proof in [Proof::Certificate, Proof::Password] {
            let folder = parent.path().join(format!("{proof:?}"));
            make(&folder, &["192.168.0.7".to_owned()], &roles(proof)).unwrap();
            let mut files = 0;
            for own in ["capture", "anna", "bob"] {
                for entry in fs::read_dir(folder.join(own)).unwrap() {
                    let mode = entry.unwrap().metadata().unwrap().permissions().mode();
                    assert_eq!(mode & 0o777, 0o600);
                    files += 1;
                }
            }
            assert_eq!(files, if proof == Proof::Certificate { 10 } else { 9 });
            assert_eq!(read_roles(&folder.join("capture")).unwrap(), roles(proof));
            assert!(check_of_viewer(&folder.join("bob")).is_ok());
            for wrong in ["capture", "nobody", ""] {
                assert!(check_of_viewer(&folder.join(wrong)).is_err(), "{wrong}");
            }
            let login = read_login(&folder.join("bob")).unwrap();
            assert_eq!(login.is_some(), proof == Proof::Password);
        }
    }

    #[test]
    fn names_that_are_folders_of_others_are_refused() {
        let parent = tempfile::tempdir().unwrap();
        for name in ["../x", "capture", "anna", ""] {
            let mut roles = roles(Proof::Certificate);
            roles.viewers = vec![name.to_owned()];
            let made = make(&parent.path().join("keys"), &[], &roles);
            assert!(
                matches!(made, Err(KeyError::Name { .. })),
                "{name}: {made:?}"
            );
        }
    }

    #[test]
    fn existing_keys_are_not_replaced() {
        let parent = tempfile::tempdir().unwrap();
        let made = make(parent.path(), &[], &roles(Proof::Certificate));
        assert!(matches!(made, Err(KeyError::Io { .. })), "{made:?}");
    }
}
