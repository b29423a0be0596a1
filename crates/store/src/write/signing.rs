//! Signatures: lines of a flight's chain that sign all lines before them, with a key that only the recorder has. A
//! rewritten chain, even with consistent digests, lacks a valid signature.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use ed25519_dalek::pkcs8::spki::der::pem::LineEnding;
use ed25519_dalek::pkcs8::{DecodePrivateKey, DecodePublicKey, EncodePrivateKey, EncodePublicKey};
use ed25519_dalek::{Signature, Signer as _, SigningKey, VerifyingKey};

use super::chain;
use super::root::StoreRoot;
use crate::disk::owner::inherit_owner;
use crate::disk::{StoreError, StoreResult, fill_random};
use crate::format::chain::{Chain, ChainEvent, ChainLine};
use crate::format::{jsonl, layout};
use wingd_base::regular_file::read_small_text;

/// Ending of the public key's file, next to the private one.
pub const PUBLIC_ENDING: &str = "pub";

/// Returns the signed message: a prefix and the digest of the chain's last line, hex.
fn signed_message(before: &str) -> String {
    format!("wingd chain {before}")
}

/// Signer of chains, with the private key.
pub struct Signer {
    key: SigningKey,
    path: PathBuf,
}

impl Signer {
    /// Reads the private key (PEM, PKCS #8). If the file does not exist, generates a key readable by this user only, and
    /// writes the public key next to it.
    pub fn load_or_create(path: &Path) -> StoreResult<Self> {
        let text = match read_small_text(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => create_signing_key(path)?,
            read => read.map_err(StoreError::io(path, "read"))?,
        };
        let key = SigningKey::from_pkcs8_pem(&text).map_err(|_| StoreError::Damaged {
            path: path.to_owned(),
            problem: "is not an Ed25519 key (PEM, PKCS #8)".to_owned(),
            remedy: "name another file; if it does not exist, a key is generated",
        })?;
        let public = append_extension(path, PUBLIC_ENDING);
        if !public.exists() {
            let text = key
                .verifying_key()
                .to_public_key_pem(LineEnding::LF)
                .unwrap_or_default();
            write_new(&public, text.as_bytes(), 0o644).map_err(StoreError::io(&public, "write"))?;
        }
        Ok(Self {
            key,
            path: path.to_owned(),
        })
    }

    /// Returns the public key, hex.
    pub fn public_key_hex(&self) -> String {
        hex::encode(self.key.verifying_key().as_bytes())
    }

    /// Signs the lines of a chain since the last signature. A broken chain, or one that does not continue the signed one,
    /// is not signed: that is evidence.
    pub(crate) fn sign_chain(&self, root: StoreRoot<'_>, flight: &Path) -> StoreResult<()> {
        let path = flight.join(layout::CHAIN_FILE);
        let bytes = root.disk.load_if_exists(&path)?.unwrap_or_default();
        if bytes.is_empty() {
            return Ok(());
        }
        // The last signature suffices: it covers the earlier ones.
        let mut links = jsonl::parse_lines::<ChainLine>(&bytes).good;
        let own = self.public_key_hex();
        let ours = |link: &ChainLine| matches!(&link.event, ChainEvent::Signature { key, .. } if *key == own);
        let last = links
            .iter()
            .rposition(|(_, link)| ours(link))
            .unwrap_or(links.len());
        let signed = check_signatures(links.split_off(last), &PublicKey(self.key.verifying_key()));
        let fault = Chain::parse(&bytes)
            .faults
            .into_iter()
            .chain(signed.invalid)
            .next();
        if let Some(problem) = fault {
            return Err(StoreError::Damaged {
                path,
                problem: format!("{problem}; it is not signed"),
                remedy: "run `wingd verify` for details; restore the flight from a copy",
            });
        }
        if signed.valid > 0 && signed.unsigned == 0 {
            return Ok(());
        }
        let signed = |before: &str| ChainEvent::Signature {
            key: self.public_key_hex(),
            signature: hex::encode(self.key.sign(signed_message(before).as_bytes()).to_bytes()),
        };
        chain::append_event_with(root, flight, signed)
    }

    /// Returns the path of the private key.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn append_extension(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

fn create_signing_key(path: &Path) -> StoreResult<String> {
    let mut seed = [0; 32];
    fill_random(&mut seed).map_err(StoreError::io(Path::new("/dev/urandom"), "read"))?;
    let text = SigningKey::from_bytes(&seed).to_pkcs8_pem(LineEnding::LF);
    let text =
        text.map_err(|error| StoreError::io(path, "write")(io::Error::other(error.to_string())))?;
    write_new(path, text.as_bytes(), 0o600).map_err(StoreError::io(path, "write"))?;
    Ok(text.to_string())
}

/// Writes a file that must not exist yet, durably: an incomplete key would be invalid at the next start.
#[allow(clippy::disallowed_methods)] // a key is not a file of the store, and needs its own mode
fn write_new(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    let part = append_extension(path, "part");
    let mut file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .mode(mode)
        .open(&part)?;
    inherit_owner(&part)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&part, path)?;
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    fs::File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// Returns a sentence if every user of the machine can read a private key, and sign with it.
pub fn exposure(path: &Path) -> Option<String> {
    let mode = fs::metadata(path).ok()?.mode();
    let (path, remedy) = (
        path.display(),
        "chmod 600 it, and use a new key if it was read",
    );
    (mode & 0o004 != 0).then(|| format!("{path}: every user can read this signing key; {remedy}"))
}

/// Public key for checking signatures.
#[derive(Clone, Debug, PartialEq)]
pub struct PublicKey(VerifyingKey);

impl PublicKey {
    /// Reads a public key as [`Signer::load_or_create`] writes it (PEM).
    pub fn read(path: &Path) -> StoreResult<Self> {
        let text = read_small_text(path).map_err(StoreError::io(path, "read"))?;
        VerifyingKey::from_public_key_pem(&text).map(Self).map_err(|_| StoreError::Damaged {
            path: path.to_owned(),
            problem: "is not a public Ed25519 key (PEM)".to_owned(),
            remedy: "name the file with the ending .pub that the recorder wrote next to its private key",
        })
    }

    fn is_valid_signature(&self, before: &str, signature: &str) -> bool {
        let bytes = hex::decode(signature)
            .ok()
            .and_then(|bytes| Signature::from_slice(&bytes).ok());
        bytes.is_some_and(|signature| {
            self.0
                .verify_strict(signed_message(before).as_bytes(), &signature)
                .is_ok()
        })
    }
}

/// Result of checking a chain's signatures.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SignatureCheck {
    /// Number of valid signatures by the key.
    pub valid: usize,
    /// Invalid signatures by the key, one sentence each.
    pub invalid: Vec<String>,
    /// Number of lines after the last valid one.
    pub unsigned: usize,
}

/// Checks the signatures of one key in numbered lines of a chain. The order of the lines is checked by [`Chain::parse`].
pub(crate) fn check_signatures(
    links: Vec<(usize, ChainLine)>,
    public: &PublicKey,
) -> SignatureCheck {
    let mut found = SignatureCheck::default();
    let ours = hex::encode(public.0.as_bytes());
    for (number, link) in links {
        found.unsigned += 1;
        match link.event {
            ChainEvent::Signature { key, signature } if key == ours => {
                if public.is_valid_signature(&link.before, &signature) {
                    found.valid += 1;
                    found.unsigned = 0;
                } else {
                    found
                        .invalid
                        .push(format!("the signature in line {number} is not valid"));
                }
            }
            _ => {}
        }
    }
    found
}
