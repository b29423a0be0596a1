//! Signatures: a line in a flight's chain that signs all the lines before it, with a key that only the
//! recorder has. What somebody rewrote, digests and all, then lacks its signature.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use ed25519_dalek::pkcs8::spki::der::pem::LineEnding;
use ed25519_dalek::pkcs8::{DecodePrivateKey, DecodePublicKey, EncodePrivateKey, EncodePublicKey};
use ed25519_dalek::{Signature, Signer as _, SigningKey, VerifyingKey};

use super::chain;
use super::root::StoreRoot;
use crate::store::disk::{StoreError, fill_random};
use crate::store::format::chain::{Chain, ChainEvent, ChainLine};
use crate::store::format::{jsonl, layout};

/// Ending of the public key's file beside the secret one.
pub const PUBLIC_ENDING: &str = "pub";

/// What is signed: these words and the digest of the chain's last line, hex.
fn signed_message(before: &str) -> String {
    format!("wingd chain {before}")
}

/// Signs.
pub struct Signer {
    key: SigningKey,
    path: PathBuf,
}

impl Signer {
    /// Reads the key (PEM, PKCS #8), or makes one where there is none, readable by this user alone; the
    /// public key is written beside it.
    pub fn load_or_create(path: &Path) -> Result<Self, StoreError> {
        let text = match fs::read_to_string(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => create_key(path)?,
            read => read.map_err(StoreError::io(path, "read"))?,
        };
        let key = SigningKey::from_pkcs8_pem(&text).map_err(|_| StoreError::Damaged {
            path: path.to_owned(),
            problem: "is not an Ed25519 key (PEM, PKCS #8)".to_owned(),
            remedy: "name another file; a new key is made where there is none",
        })?;
        let public = with_ending(path, PUBLIC_ENDING);
        if !public.exists() {
            let text = key.verifying_key().to_public_key_pem(LineEnding::LF).unwrap_or_default();
            write_new(&public, text.as_bytes(), 0o644).map_err(StoreError::io(&public, "write"))?;
        }
        Ok(Self { key, path: path.to_owned() })
    }

    /// The key that others check with, hex.
    pub fn public_key_hex(&self) -> String {
        hex::encode(self.key.verifying_key().as_bytes())
    }

    /// Signs what the chain has since the last signature. A chain that is broken, or not the one that was
    /// signed, is not signed: that is evidence.
    pub(crate) fn sign_chain(&self, root: StoreRoot<'_>, flight: &Path) -> Result<(), StoreError> {
        let path = flight.join(layout::CHAIN_FILE);
        let bytes = root.disk.load_if_exists(&path)?.unwrap_or_default();
        if bytes.is_empty() {
            return Ok(());
        }
        // The last signature is enough: it signs the ones before.
        let mut links = jsonl::parse_lines::<ChainLine>(&bytes).good;
        let ours = |link: &ChainLine| matches!(&link.event, ChainEvent::Signature { key, .. } if *key == self.public_key_hex());
        let last = links.iter().rposition(|(_, link)| ours(link)).unwrap_or(links.len());
        let signed = check_signatures(links.split_off(last), &PublicKey(self.key.verifying_key()));
        let fault = Chain::parse(&bytes).faults.into_iter().chain(signed.invalid).next();
        if let Some(what) = fault {
            return Err(StoreError::Damaged {
                path,
                problem: format!("{what}; it is not signed"),
                remedy: "`wingd verify` says more; take the flight from a copy",
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

    /// Where the key lies.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

fn create_key(path: &Path) -> Result<String, StoreError> {
    let mut seed = [0; 32];
    fill_random(&mut seed).map_err(StoreError::io(Path::new("/dev/urandom"), "read"))?;
    let text = SigningKey::from_bytes(&seed).to_pkcs8_pem(LineEnding::LF);
    let text = text.map_err(|error| StoreError::io(path, "write")(io::Error::other(error.to_string())))?;
    write_new(path, text.as_bytes(), 0o600).map_err(StoreError::io(path, "write"))?;
    Ok(text.to_string())
}

/// Writes a file that must not exist yet, durably: half a key would be no key at the next start.
#[allow(clippy::disallowed_methods)] // a key is no file of the store, and needs its own mode
fn write_new(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    let part = with_ending(path, "part");
    let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(mode).open(&part)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&part, path)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    fs::File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// Checks signatures.
#[derive(Clone, Debug, PartialEq)]
pub struct PublicKey(VerifyingKey);

impl PublicKey {
    /// Reads a key as [`Signer::load_or_make`] writes it (PEM).
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let text = fs::read_to_string(path).map_err(StoreError::io(path, "read"))?;
        VerifyingKey::from_public_key_pem(&text).map(Self).map_err(|_| StoreError::Damaged {
            path: path.to_owned(),
            problem: "is not a public Ed25519 key (PEM)".to_owned(),
            remedy: "name the file with the ending .pub that the recorder wrote beside its own key",
        })
    }

    fn verifies(&self, before: &str, signature: &str) -> bool {
        let bytes = hex::decode(signature).ok().and_then(|bytes| Signature::from_slice(&bytes).ok());
        bytes.is_some_and(|signature| self.0.verify_strict(signed_message(before).as_bytes(), &signature).is_ok())
    }
}

/// What a chain's signatures say.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SignatureCheck {
    /// Signatures by this key that are good.
    pub valid: usize,
    /// Those that are not, one sentence each.
    pub invalid: Vec<String>,
    /// Lines after the last good one.
    pub unsigned: usize,
}

/// Looks at the signatures of one key in a chain's lines, numbered. Whether they follow from one another is
/// [`Chain::parse`]'s.
pub(crate) fn check_signatures(links: Vec<(usize, ChainLine)>, public: &PublicKey) -> SignatureCheck {
    let mut found = SignatureCheck::default();
    let ours = hex::encode(public.0.as_bytes());
    for (number, link) in links {
        found.unsigned += 1;
        match link.event {
            ChainEvent::Signature { key, signature } if key == ours => {
                if public.verifies(&link.before, &signature) {
                    found.valid += 1;
                    found.unsigned = 0;
                } else {
                    found.invalid.push(format!("the signature in line {number} is not good"));
                }
            }
            _ => {}
        }
    }
    found
}
