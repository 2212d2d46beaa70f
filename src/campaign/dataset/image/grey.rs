//! Grey frames that programs store in colours: all channels of each pixel are equal.

/// Appends the codes of pixels with so many channels of 8 or 16 bits, big-endian; the last of two or four
/// is the opacity. Returns false at the first pixel that has a colour or is not opaque.
pub(super) fn put(bytes: &[u8], channels: usize, bits: u8, dn: &mut Vec<u16>) -> bool {
    match (channels, bits) {
        (1, 8) => dn.extend(bytes.iter().map(|b| u16::from(*b))),
        (1, _) => dn.extend(bytes.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b))),
        _ => return put_equal(bytes, channels, usize::from(bits / 8), dn),
    }
    true
}

fn put_equal(bytes: &[u8], channels: usize, of_channel: usize, dn: &mut Vec<u16>) -> bool {
    let colours = if channels < 3 { 1 } else { 3 };
    bytes.chunks_exact(channels * of_channel).all(|pixel| {
        let (all, opacity) = pixel.split_at(colours * of_channel);
        let code = &all[..of_channel];
        dn.push(code.iter().fold(0, |sum, byte| sum << 8 | u16::from(*byte)));
        opacity.iter().all(|byte| *byte == u8::MAX) && all.chunks_exact(of_channel).all(|c| c == code)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One, two, three and four channels of both depths; a colour and a transparent pixel are refused.
    #[test]
    fn equal_channels_are_grey() {
        let codes = |bytes: &[u8], channels, bits| {
            let mut dn = Vec::new();
            put(bytes, channels, bits, &mut dn).then_some(dn)
        };
        assert_eq!(codes(&[1, 2], 1, 8), Some(vec![1, 2]));
        assert_eq!(codes(&[1, 255, 2, 255], 2, 8), Some(vec![1, 2]));
        assert_eq!(codes(&[1, 2, 1, 2, 1, 2], 3, 16), Some(vec![258]));
        assert_eq!(codes(&[7, 7, 7, 255, 9, 9, 9, 255], 4, 8), Some(vec![7, 9]));
        assert_eq!(codes(&[7, 7, 8], 3, 8), None);
        assert_eq!(codes(&[7, 7, 7, 254], 4, 8), None);
    }
}
