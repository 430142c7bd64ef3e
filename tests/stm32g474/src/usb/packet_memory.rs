//! Packet memory, with the buffer descriptor table in it (RM0440, 45.6.2).
//!
//! On the G4 the memory is 1 KiB, which the program addresses without gaps: "2 x 16 bits / word".

/// Size in bytes.
pub const SIZE: usize = 1024;

/// Bytes of a descriptor: ADDRn_TX, COUNTn_TX, ADDRn_RX, COUNTn_RX.
const DESCRIPTOR: usize = 8;
/// Number of descriptors in the table.
const ENDPOINTS: usize = 8;
/// Low ten bits of a COUNT.
const COUNT: u16 = 0x3FF;

/// Packet memory of the USB peripheral.
pub struct PacketMemory {
    bytes: [u8; SIZE],
    /// Offset of the descriptors: USB_BTABLE.
    pub table: usize,
}

/// Part of the packet memory, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Buffer {
    /// Offset of the first byte.
    pub start: usize,
    /// Number of bytes.
    pub length: usize,
}

impl Buffer {
    /// Returns `true` if an access overlaps the buffer.
    pub fn touches(self, offset: usize, size: usize) -> bool {
        offset < self.start + self.length && self.start < offset + size
    }
}

impl Default for PacketMemory {
    fn default() -> Self {
        Self {
            bytes: [0; SIZE],
            table: 0,
        }
    }
}

impl PacketMemory {
    /// Reads `size` bytes from `offset`, little-endian; zeros outside the memory.
    pub fn read(&self, offset: usize, size: usize) -> u32 {
        let byte = |i: usize| u32::from(self.bytes.get(offset + i).copied().unwrap_or(0));
        (0..size).fold(0, |value, i| value | byte(i) << (8 * i))
    }

    /// Writes `size` bytes from `offset`; no effect outside the memory.
    pub fn write(&mut self, offset: usize, size: usize, value: u32) {
        for (i, byte) in value.to_le_bytes().into_iter().take(size).enumerate() {
            if let Some(place) = self.bytes.get_mut(offset + i) {
                *place = byte;
            }
        }
    }

    fn half(&self, index: usize, place: usize) -> u16 {
        // Two bytes always fit.
        self.read(self.table + DESCRIPTOR * index + 2 * place, 2) as u16
    }

    /// Buffer that register `index` sends.
    pub fn sent(&self, index: usize) -> Buffer {
        let length = usize::from(self.half(index, 1) & COUNT);
        Buffer {
            start: self.half(index, 0).into(),
            length,
        }
    }

    /// Buffer into which register `index` receives: blocks of 2 bytes, or of 32 bytes and one more than the field's value.
    pub fn received(&self, index: usize) -> Buffer {
        let count = self.half(index, 3);
        let blocks = usize::from(count >> 10 & 0x1F);
        let length = if count & 0x8000 == 0 {
            2 * blocks
        } else {
            32 * (blocks + 1)
        };
        Buffer {
            start: self.half(index, 2).into(),
            length,
        }
    }

    /// Defect of a buffer of register `index`, if any.
    pub fn defect(&self, index: usize, buffer: Buffer) -> Option<&'static str> {
        let own_descriptors = self.table..self.table + DESCRIPTOR * (index + 1);
        if !buffer.start.is_multiple_of(2) {
            Some("at an odd address")
        } else if buffer.start + buffer.length > SIZE {
            Some("outside the packet memory")
        } else if self.table + DESCRIPTOR * ENDPOINTS > SIZE {
            Some("described outside the packet memory")
        } else if buffer.length > 0 && buffer.touches(own_descriptors.start, own_descriptors.len())
        {
            Some("over the descriptors")
        } else {
            None
        }
    }

    /// Bytes of a buffer.
    pub fn bytes(&self, buffer: Buffer) -> Vec<u8> {
        let all = self.bytes.get(buffer.start..buffer.start + buffer.length);
        all.map_or_else(Vec::new, <[u8]>::to_vec)
    }

    /// Stores a packet for register `index`; returns `false` if it does not fit, and stores only its beginning.
    pub fn receive(&mut self, index: usize, packet: &[u8]) -> bool {
        let buffer = self.received(index);
        let kept = packet.len().min(buffer.length);
        for (i, byte) in packet[..kept].iter().enumerate() {
            self.write(buffer.start + i, 1, (*byte).into());
        }
        if kept < packet.len() {
            return false;
        }
        let blocks = self.half(index, 3) & !COUNT;
        let count = u32::from(blocks) | kept as u32;
        self.write(self.table + DESCRIPTOR * index + 6, 2, count);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_as_the_descriptors_say() {
        let mut memory = PacketMemory::default();
        memory.write(8, 2, 0x140);
        memory.write(10, 2, 5);
        memory.write(12, 2, 0x180);
        memory.write(14, 2, 0x8400);
        assert_eq!(
            memory.sent(1),
            Buffer {
                start: 0x140,
                length: 5
            }
        );
        assert_eq!(
            memory.received(1),
            Buffer {
                start: 0x180,
                length: 64
            }
        );
        memory.write(14, 2, 4 << 10);
        assert_eq!(memory.received(1).length, 8);
        assert!(memory.receive(1, b"12345678"));
        assert_eq!(memory.read(14, 2), 4 << 10 | 8);
        assert!(!memory.receive(1, b"123456789"));
    }

    #[test]
    fn defects_are_named() {
        let memory = PacketMemory::default();
        let defect = |start, length| memory.defect(1, Buffer { start, length });
        assert_eq!(defect(64, 64), None);
        assert!(defect(65, 64).is_some());
        assert!(defect(8, 8).is_some());
        assert!(defect(1000, 64).is_some());
    }
}
