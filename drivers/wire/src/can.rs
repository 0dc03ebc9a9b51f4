//! A classic CAN data frame.

/// A classic CAN data frame: arbitration id and up to 8 bytes. Error and remote frames are the link's affair.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CanFrame {
    arbitration_id: u32,
    extended: bool,
    data: [u8; 8],
    dlc: u8,
}

impl CanFrame {
    /// A frame with an 11-bit id, or `None` when the id has more bits or there are more than 8 bytes.
    #[must_use]
    pub fn standard(arbitration_id: u16, payload: &[u8]) -> Option<Self> {
        (arbitration_id <= 0x7FF).then(|| Self::build(u32::from(arbitration_id), false, payload))?
    }

    /// A frame with a 29-bit id, or `None` when the id has more bits or there are more than 8 bytes.
    #[must_use]
    pub fn extended(arbitration_id: u32, payload: &[u8]) -> Option<Self> {
        (arbitration_id <= 0x1FFF_FFFF).then(|| Self::build(arbitration_id, true, payload))?
    }

    fn build(arbitration_id: u32, extended: bool, payload: &[u8]) -> Option<Self> {
        let mut data = [0; 8];
        data.get_mut(..payload.len())?.copy_from_slice(payload);
        Some(Self {
            arbitration_id,
            extended,
            data,
            dlc: u8::try_from(payload.len()).ok()?,
        })
    }

    /// The arbitration id, 11 or 29 bits.
    #[must_use]
    pub const fn arbitration_id(&self) -> u32 {
        self.arbitration_id
    }

    /// Whether the id has 29 bits.
    #[must_use]
    pub const fn is_extended(&self) -> bool {
        self.extended
    }

    /// The data bytes, as many as the DLC says.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        self.data.get(..usize::from(self.dlc)).unwrap_or_default()
    }
}
