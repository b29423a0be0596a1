//! Completeness check of JPEG files, without decoding.

/// Reason why a JPEG file is not complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JpegError {
    /// Missing first marker; number of bytes.
    #[error("not a JPEG file: {0} bytes without a start marker")]
    NotJpeg(usize),
    /// Missing end; number of bytes.
    #[error("JPEG file is truncated after {0} bytes")]
    Truncated(usize),
    /// Missing marker at this byte.
    #[error("JPEG file is damaged at byte {0}")]
    Damaged(usize),
    /// Missing scan.
    #[error("JPEG file contains no image")]
    Empty,
}

/// Walks the markers from SOI to EOI (ITU-T T.81, annex B). Bytes after EOI are allowed, as cameras pad and append
/// previews, and zeros before SOI, as the decoder skips them.
///
/// # Errors
/// Returns an error if the file is not complete.
pub fn check_complete(bytes: &[u8]) -> Result<(), JpegError> {
    let zeros = bytes.iter().take_while(|b| **b == 0).count();
    let bytes = &bytes[zeros..];
    if !bytes.starts_with(&[0xFF, 0xD8]) {
        return Err(JpegError::NotJpeg(bytes.len()));
    }
    let cut = || JpegError::Truncated(bytes.len());
    let mut at = 2;
    let mut scans = 0;
    loop {
        let marker = loop {
            match (bytes.get(at), bytes.get(at + 1)) {
                (Some(0xFF), Some(0xFF)) => at += 1,
                (Some(0xFF), Some(marker)) => break *marker,
                (Some(_), _) => return Err(JpegError::Damaged(at)),
                _ => return Err(cut()),
            }
        };
        at += 2;
        match marker {
            0xD9 if scans > 0 => return Ok(()),
            0xD9 => return Err(JpegError::Empty),
            0x01 | 0xD0..=0xD7 => continue,
            _ => {}
        }
        let length = match (bytes.get(at), bytes.get(at + 1)) {
            (Some(high), Some(low)) => usize::from(u16::from_be_bytes([*high, *low])),
            _ => return Err(cut()),
        };
        at += length.max(2);
        if marker == 0xDA {
            scans += 1;
            at = find_scan_end(bytes, at).ok_or_else(cut)?;
        }
    }
}

/// Finds the next marker after entropy-coded data that is neither a stuffed byte nor a restart.
fn find_scan_end(bytes: &[u8], from: usize) -> Option<usize> {
    let data = bytes.get(from..)?;
    let is_marker = |at: &usize| {
        data.get(at + 1)
            .is_some_and(|next| !matches!(next, 0 | 0xD0..=0xD7 | 0xFF))
    };
    memchr::memchr_iter(0xFF, data)
        .find(is_marker)
        .map(|offset| from + offset)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn picture(seed: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        let grey: Vec<u8> = (0..64 * 48).map(|i| (i * seed % 251) as u8).collect();
        jpeg_encoder::Encoder::new(&mut bytes, 90)
            .encode(&grey, 64, 48, jpeg_encoder::ColorType::Luma)
            .unwrap();
        bytes
    }

    #[test]
    fn a_file_is_complete_only_at_its_full_length() {
        let bytes = picture(7);
        assert_eq!(check_complete(&bytes), Ok(()));
        for length in 0..bytes.len() {
            assert!(
                check_complete(&bytes[..length]).is_err(),
                "{length} of {}",
                bytes.len()
            );
        }
        let padded: Vec<u8> = bytes.iter().copied().chain([0; 100]).collect();
        assert_eq!(check_complete(&padded), Ok(()));
        assert_eq!(check_complete(&[&[0; 3], &bytes[..]].concat()), Ok(()));
    }

    #[test]
    fn a_hole_of_zeros_in_the_headers_is_seen() {
        let mut bytes = picture(7);
        bytes[20..200].fill(0);
        assert!(check_complete(&bytes).is_err());
    }

    proptest::proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..300)) {
            let _ = check_complete(&bytes);
            let with_start: Vec<u8> = [0xFF, 0xD8].into_iter().chain(bytes).collect();
            let _ = check_complete(&with_start);
        }
    }
}
