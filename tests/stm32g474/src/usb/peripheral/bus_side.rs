//! Bus side of the peripheral (RM0440, 45.5.2 and 45.5.5).

use super::*;

impl Usb {
    /// Handles a reset, by the bus or by FRES: complete transactions stay complete.
    pub(super) fn reset(&mut self) {
        self.flags |= istr::RESET.mask();
        self.address = 0;
        self.silent = 0;
        self.frames = 0;
        self.endpoints.iter_mut().for_each(Endpoint::bus_reset);
    }

    fn powered(&self) -> bool {
        !self.on(cntr::PDWN) && !self.on(cntr::FRES)
    }

    /// Handles activity on the bus: a suspended peripheral wakes.
    fn activity(&mut self) {
        self.silent = 0;
        if self.on(cntr::FSUSP) {
            self.flags |= istr::WKUP.mask();
            self.control &= !cntr::LP_MODE.mask();
        }
    }

    /// Register that serves an endpoint; `None` before the reset is acknowledged, in suspend, or for another address or endpoint.
    fn addressed(&self, address: u8, endpoint: u8, status: Field) -> Option<usize> {
        let listens = self.powered()
            && istr::RESET.extract(self.flags) == 0
            && !self.on(cntr::FSUSP)
            && daddr::EF.extract(self.address) != 0
            && daddr::ADD.extract(self.address) == u32::from(address);
        let answers = |e: &Endpoint| {
            e.get(ep0r::EA) == u32::from(endpoint) && e.get(status) != endpoint::DISABLED
        };
        self.endpoints.iter().position(answers).filter(|_| listens)
    }

    /// Stores a packet; returns its handshake.
    fn take(&mut self, index: usize, packet: &[u8]) -> Handshake {
        if !self.memory.receive(index, packet) {
            let length = packet.len();
            self.report(format!(
                "EP{index}R has no room for a packet of {length} bytes"
            ));
            return Handshake::Stall;
        }
        let endpoint = &mut self.endpoints[index];
        endpoint.put(ep0r::STAT_RX, endpoint::NAK);
        endpoint.put(ep0r::CTR_RX, 1);
        Handshake::Ack
    }
}

fn bit(toggle: Toggle) -> u32 {
    u32::from(toggle == Toggle::Data1)
}

impl Device for Usb {
    fn attached(&self) -> bool {
        self.charging & PULL_UP != 0 && !self.on(cntr::PDWN)
    }

    fn bus_reset(&mut self) {
        if self.powered() {
            self.activity();
            self.reset();
        }
    }

    fn start_of_frame(&mut self, number: u16) {
        if self.powered() {
            self.activity();
            self.frame = fnr::FN.extract(number.into());
            self.frames = (self.frames + 1).min(3);
            self.flags |= istr::SOF.mask();
        }
    }

    fn missing_frame(&mut self) {
        // In suspend, no frame is expected.
        if !self.powered() || self.on(cntr::FSUSP) {
            return;
        }
        self.frames = 0;
        self.silent = (self.silent + 1).min(4);
        self.flags |= istr::ESOF.mask();
        if self.silent == 3 {
            self.flags |= istr::SUSP.mask();
        }
    }

    fn setup(&mut self, address: u8, endpoint: u8, packet: [u8; 8]) -> Handshake {
        let Some(index) = self.addressed(address, endpoint, ep0r::STAT_RX) else {
            return Handshake::Nothing;
        };
        let register = &self.endpoints[index];
        // No SETUP is accepted before the last one is acknowledged: it would be lost.
        if register.get(ep0r::EP_TYPE) != endpoint::CONTROL || register.get(ep0r::CTR_RX) != 0 {
            return Handshake::Nothing;
        }
        let handshake = self.take(index, &packet);
        if handshake == Handshake::Ack {
            let register = &mut self.endpoints[index];
            register.put(ep0r::SETUP, 1);
            register.put(ep0r::STAT_TX, endpoint::NAK);
            register.put(ep0r::DTOG_RX, 1);
            register.put(ep0r::DTOG_TX, 1);
        }
        handshake
    }

    fn out(&mut self, address: u8, endpoint: u8, toggle: Toggle, data: &[u8]) -> Handshake {
        let Some(index) = self.addressed(address, endpoint, ep0r::STAT_RX) else {
            return Handshake::Nothing;
        };
        let register = &mut self.endpoints[index];
        match register.get(ep0r::STAT_RX) {
            STALL => return Handshake::Stall,
            VALID => {}
            _ => return Handshake::Nak,
        }
        // Repeated packet, since the device's handshake was lost: acknowledged again.
        if register.get(ep0r::DTOG_RX) != bit(toggle) {
            return Handshake::Ack;
        }
        let control = register.get(ep0r::EP_TYPE) == endpoint::CONTROL;
        let status_only = control && register.get(ep0r::EP_KIND) != 0;
        if status_only && !data.is_empty() {
            register.put(ep0r::STAT_RX, STALL);
            return Handshake::Stall;
        }
        let handshake = self.take(index, data);
        if handshake == Handshake::Ack {
            let register = &mut self.endpoints[index];
            register.put(ep0r::DTOG_RX, bit(toggle.next()));
            register.put(ep0r::SETUP, 0);
        }
        handshake
    }

    fn input(&mut self, address: u8, endpoint: u8) -> Answer {
        let Some(index) = self.addressed(address, endpoint, ep0r::STAT_TX) else {
            return Answer::Nothing;
        };
        let data = self.memory.bytes(self.memory.sent(index));
        let register = &mut self.endpoints[index];
        match register.get(ep0r::STAT_TX) {
            STALL => return Answer::Stall,
            VALID => {}
            _ => return Answer::Nak,
        }
        let second = register.get(ep0r::DTOG_TX) != 0;
        let toggle = if second { Toggle::Data1 } else { Toggle::Data0 };
        register.put(ep0r::STAT_TX, endpoint::NAK);
        register.put(ep0r::CTR_TX, 1);
        register.put(ep0r::DTOG_TX, bit(toggle.next()));
        if register.get(ep0r::CTR_RX) == 0 {
            register.put(ep0r::SETUP, 0);
        }
        Answer::Data(toggle, data)
    }
}
