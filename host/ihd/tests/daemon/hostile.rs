//! Devices that mean no good, or are broken: each is a name and what it does with a connection.

use std::io;
use std::time::{Duration, Instant};

use ihd_shared::fault::Fault;
use ihd_shared::sampling::{CODE_MAX, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::hello::{ROLE_DEVICE, ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    FaultEvent, FrontEnd, LookupBlob, MESSAGES, Outcome, Raw, Reply, State, Stream, Telemetry,
    WindowChunk, WindowEnd, WindowStart,
};

use crate::chance::Chance;
use crate::device::{Polite, Samples, Wire, telemetry};

/// Behaviour of a device during a connection.
pub type Serve = fn(&mut Wire) -> io::Result<()>;

/// All of them.
pub const ALL: &[(&str, Serve)] = &[
    // Before the handshake.
    ("silence", |w| {
        loop {
            w.next(A_WHILE)?;
        }
    }),
    ("closes at once", |_| Ok(())),
    ("ssh banner", |w| {
        w.bytes(b"SSH-2.0-OpenSSH_9.2\r\n")?;
        w.next(A_WHILE).map(drop)
    }),
    ("http answer", |w| {
        w.bytes(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")?;
        w.next(A_WHILE).map(drop)
    }),
    ("garbage flood", garbage),
    ("zeros flood", |w| flood(w, &[0; 16 * 1024])),
    ("endless frame", |w| flood(w, &[1; 16 * 1024])),
    ("one byte a second", |w| {
        let hello = w.framed(&Polite::new(1).hello);
        dribble(w, &hello)
    }),
    ("flood of hellos", |w| {
        let hello = w.framed(&Polite::new(1).hello);
        flood(w, &hello.repeat(100))
    }),
    ("unasked replies", |w| {
        let reply = w.framed(&Reply {
            outcome: Outcome::Ok,
            detail: 0,
        });
        flood(w, &reply.repeat(1_000))
    }),
    ("closes after the hello", |w| {
        w.next(A_WHILE)?;
        w.send(&Polite::new(1).hello)
    }),
    ("another magic", |w| with_hello(w, |d| d.hello.magic = 0)),
    ("role of a host", |w| {
        with_hello(w, |d| d.hello.role = ROLE_HOST)
    }),
    ("other major", |w| {
        with_hello(w, |d| d.hello.protocol_major += 1)
    }),
    ("major of old", |w| {
        with_hello(w, |d| d.hello.protocol_major = 0)
    }),
    ("huge version", |w| {
        with_hello(w, |d| {
            (d.hello.protocol_major, d.hello.protocol_minor) = (u16::MAX, u16::MAX)
        })
    }),
    ("other table", |w| {
        with_hello(w, |d| d.hello.schema_hash ^= 1)
    }),
    ("escapes in its name", |w| {
        with_hello(w, |d| {
            let build = "\u{1b}[2J\u{1b}]0;gone\u{7}\u{9b}31m";
            d.hello = ours(ROLE_DEVICE, 0, 2, build, "a\"b\\c\n\r\0\u{202e}{}%s<b>");
        })
    }),
    ("lies about its channels", |w| {
        with_hello(w, |d| {
            d.front_end = FrontEnd {
                v_full_scale_mv: 0,
                i_full_scale_ma: u32::MAX,
                bus_full_scale_mv: 0,
                mains_full_scale_mv: u32::MAX,
                bits: 255,
            };
        })
    }),
    // After it.
    ("telemetry flood", telemetry_flood),
    ("telemetry of extremes", telemetry_of_extremes),
    ("telemetry numbers jump", |w| {
        shaken(w, |w, k| {
            let seq = k.wrapping_mul(0x2345_6789);
            w.send(&Telemetry {
                dropped: u32::MAX - k,
                half_cycle: !seq,
                ..telemetry(seq)
            })
        })
    }),
    ("window that never ends", never_ending_window),
    ("windows that only begin", |w| {
        shaken(w, |w, k| {
            w.send(&WindowStart {
                pairs: u16::MAX,
                trajectory: u16::MAX,
                ..Samples::default().start(k)
            })
        })
    }),
    ("windows that lie about lengths", lying_lengths),
    ("windows of zeros", |w| {
        windows(w, |_, start| {
            (start.f_sw_hz, start.half_cycle_ns) = (0, 0);
            (start.v_full_scale_mv, start.i_full_scale_ma) = (0, 0);
        })
    }),
    ("windows of extremes", |w| {
        windows(w, |k, start| {
            start.f_sw_hz = u32::MAX - k;
            start.half_cycle_ns = u32::MAX;
            (start.first_pair_ns, start.first_trajectory_ns) = (i32::MIN, i32::MAX);
            (start.v_full_scale_mv, start.i_full_scale_ma) = (u32::MAX, 1);
            (start.half_cycle, start.lookup_version) = (u32::MAX, u32::MAX);
        })
    }),
    ("windows in negative time", |w| {
        windows(w, |k, start| {
            start.first_pair_ns = -9_000_000;
            start.half_cycle = 1_000u32.wrapping_sub(k);
        })
    }),
    ("the same window again", |w| {
        windows(w, |_, start| start.seq = 7)
    }),
    ("windows numbered backwards", |w| {
        windows(w, |k, start| start.seq = 1_000u32.wrapping_sub(k))
    }),
    ("windows whose numbers jump", |w| {
        windows(w, |k, start| {
            start.seq = k.wrapping_mul(0x7FFF_FFFF);
            start.dropped = u32::MAX.wrapping_sub(k);
        })
    }),
    ("windows of one code", |w| {
        let flat = |v| Samples::new((0..10_000).map(|_| v), &[]);
        let code = CODE_MAX.to_le_bytes();
        let ends = Pair::from_le_bytes([code[0], code[1], code[0], code[1]]);
        shaken(w, move |w, k| {
            let samples = if k % 2 == 0 {
                flat(Pair::from_le_bytes([0; 4]))
            } else {
                flat(ends)
            };
            w.window(&samples.start(k), &samples)
        })
    }),
    ("windows of noise", windows_of_noise),
    ("faults of every number", faults),
    ("lookup of the last version", |w| {
        with_hello(w, |d| {
            d.status.lookup_version = u32::MAX;
            let mut lookup = ihd_shared::lookup::prior::prior();
            lookup.version = u32::MAX;
            d.lookup = lookup.to_bytes().to_vec();
        })
    }),
    ("lookup that is none", |w| {
        with_hello(w, |d| d.lookup = vec![0xA5; 900])
    }),
    ("empty lookup", |w| with_hello(w, |d| d.lookup = Vec::new())),
    ("lookup version is another than said", |w| {
        with_hello(w, |d| d.status.lookup_version = 12)
    }),
    ("takes lookups and never uses them", |w| {
        with_hello(w, |d| d.activates = false)
    }),
    ("refuses everything", refuses_everything),
    ("answers to another command", another_command),
    ("answers late", |w| {
        let mut device = Polite::new(6);
        while let Some((id, payload)) = w.next(A_WHILE)? {
            std::thread::sleep(Duration::from_millis(1_900));
            device.answer(w, id, &payload)?;
        }
        Ok(())
    }),
    ("answers everything twice", |w| {
        let mut device = Polite::new(6);
        loop {
            if let Some((id, payload)) = w.next(A_WHILE)? {
                device.answer(w, id, &payload)?;
                device.answer(w, id, &payload)?;
            }
        }
    }),
    ("boots every second", boots_every_second),
    ("says another hello in between", |w| {
        let mut device = Polite::new(1);
        shaken(w, move |w, k| {
            device.hello.boot_id = k;
            w.send(&device.hello)?;
            w.send(&telemetry(k))
        })
    }),
    ("closes after each answer", |w| {
        let mut device = Polite::new(5);
        // Far enough to be taken for a device.
        for _ in 0..3 {
            device.attend(w, A_WHILE)?;
        }
        Ok(())
    }),
    ("payloads cut short", |w| {
        damaged_payloads(w, |bytes| bytes.truncate(bytes.len() / 2))
    }),
    ("payloads with more behind", |w| {
        damaged_payloads(w, |bytes| bytes.extend([0xFF; 100]))
    }),
    ("unknown messages", |w| {
        shaken(w, |w, k| w.send_raw((k % 251) as u8, &[0xEE; 64]))
    }),
    ("status of extremes", status_of_extremes),
    ("falls silent after the hello", |w| {
        let mut device = Polite::new(8);
        for _ in 0..6 {
            device.attend(w, A_WHILE)?;
        }
        loop {
            w.next(A_WHILE)?;
        }
    }),
    ("reads nothing and floods", |w| {
        let mut device = Polite::new(9);
        device.attend(w, A_WHILE)?;
        let frame = w.framed(&telemetry(1));
        flood(w, &frame.repeat(200))
    }),
];

const A_WHILE: Duration = Duration::from_millis(500);

fn flood(w: &mut Wire, bytes: &[u8]) -> io::Result<()> {
    loop {
        w.bytes(bytes)?;
    }
}

fn garbage(w: &mut Wire) -> io::Result<()> {
    let mut chance = Chance::new(1);
    let bytes: Vec<u8> = (0..64 * 1024).map(|_| chance.next() as u8).collect();
    flood(w, &bytes)
}

fn dribble(w: &mut Wire, bytes: &[u8]) -> io::Result<()> {
    for byte in bytes {
        w.bytes(&[*byte])?;
        std::thread::sleep(Duration::from_secs(1));
    }
    Ok(())
}

fn with_hello(w: &mut Wire, change: fn(&mut Polite)) -> io::Result<()> {
    let mut device = Polite::new(2);
    change(&mut device);
    device.serve(w)
}

/// Answers politely until the host wants something streamed, and then does `more` between two answers, with the
/// numbers from 0.
fn shaken(w: &mut Wire, mut more: impl FnMut(&mut Wire, u32) -> io::Result<()>) -> io::Result<()> {
    let mut device = Polite::new(3);
    device.status.state = State::Heating;
    let wants = |stream: &Stream| stream.telemetry_every > 0 || stream.windows_every > 0;
    let mut k = 0;
    loop {
        device.attend(
            w,
            Duration::from_millis(if wants(&device.stream) { 1 } else { 50 }),
        )?;
        if wants(&device.stream) {
            more(w, k)?;
            k = k.wrapping_add(1);
        }
    }
}

fn telemetry_flood(w: &mut Wire) -> io::Result<()> {
    shaken(w, |w, k| {
        let mut out = Vec::new();
        for n in 0..2_000 {
            out.extend(w.framed(&telemetry(k.wrapping_mul(2_000).wrapping_add(n))));
        }
        w.bytes(&out)
    })
}

fn telemetry_of_extremes(w: &mut Wire) -> io::Result<()> {
    shaken(w, |w, k| {
        let odd = k % 2 == 1;
        let (small, large) = if odd {
            (i32::MIN, u32::MAX)
        } else {
            (i32::MAX, 0)
        };
        w.send(&Telemetry {
            dropped: large,
            half_cycle: large,
            state: State::LockedOut,
            fault: Fault::from_number(u16::MAX - k as u16),
            f_sw_hz: large,
            r: MicroOhm(small),
            l: PicoHenry(small),
            i_crest_ma: large,
            power_mw: large,
            phase_mrad: i16::MIN,
            lookup_version: large,
            asked_w: u16::MAX,
            i_turn_off_min_ma: small,
            bus_peak_dv: u16::MAX,
            v_coil_peak_dv: u16::MAX,
            ..telemetry(if odd { u32::MAX } else { k })
        })
    })
}

fn never_ending_window(w: &mut Wire) -> io::Result<()> {
    shaken(w, |w, k| {
        if k == 0 {
            w.send(&WindowStart {
                pairs: u16::MAX,
                trajectory: u16::MAX,
                ..Samples::default().start(0)
            })?;
        }
        let data = [0x11; 960];
        let offset = (k as u16).wrapping_mul(240);
        let chunk = w.framed(&WindowChunk {
            seq: 0,
            offset,
            data: Raw(&data),
        });
        w.bytes(&chunk)
    })
}

fn lying_lengths(w: &mut Wire) -> io::Result<()> {
    shaken(w, |w, k| {
        let data = vec![0x22; [0, 3, 4, 960, 1_000][k as usize % 5]];
        let start = WindowStart {
            pairs: [0, 1, 100, u16::MAX][k as usize % 4],
            trajectory: [0, u16::MAX, 3][k as usize % 3],
            saturated: u16::MAX,
            ..Samples::default().start(k)
        };
        w.send(&start)?;
        for offset in [0, 0, 1, u16::MAX, start.pairs] {
            let chunk = w.framed(&WindowChunk {
                seq: k,
                offset,
                data: Raw(&data),
            });
            w.bytes(&chunk)?;
        }
        w.send(&WindowEnd { seq: k, crc32: k })
    })
}

/// Whole windows with a right checksum, ten a second, whose head lies.
fn windows(w: &mut Wire, change: fn(u32, &mut WindowStart)) -> io::Result<()> {
    let samples = Samples::sines(9_000);
    shaken(w, move |w, k| {
        std::thread::sleep(Duration::from_millis(100));
        w.send(&telemetry(k))?;
        let mut start = samples.start(k);
        change(k, &mut start);
        w.window(&start, &samples)
    })
}

fn windows_of_noise(w: &mut Wire) -> io::Result<()> {
    let mut chance = Chance::new(5);
    shaken(w, move |w, k| {
        std::thread::sleep(Duration::from_millis(100));
        let pair = |_| {
            let r = chance.next();
            let code = |x: u64| ((x % 4_001) as i16 - 2_000).to_le_bytes();
            let (v, i) = (code(r & 0xFFFF_FFFF), code(r >> 32));
            Pair::from_le_bytes([v[0], v[1], i[0], i[1]])
        };
        let samples = Samples::new((0..9_000).map(pair), &[]);
        w.window(&samples.start(k), &samples)
    })
}

fn faults(w: &mut Wire) -> io::Result<()> {
    shaken(w, |w, k| {
        let fault = Fault::from_number(k as u16);
        w.send(&FaultEvent {
            half_cycle: k,
            fault,
        })?;
        w.send(&Telemetry {
            fault,
            state: State::LockedOut,
            ..telemetry(k)
        })
    })
}

fn refuses_everything(w: &mut Wire) -> io::Result<()> {
    let mut device = Polite::new(4);
    let mut k = 0u32;
    loop {
        let refusals = &Outcome::ALL[1..];
        device.outcome = (refusals[k as usize % refusals.len()], u32::MAX - k);
        k = k.wrapping_add(1);
        device.attend(w, A_WHILE)?;
    }
}

fn another_command(w: &mut Wire) -> io::Result<()> {
    let mut device = Polite::new(4);
    // The handshake is right: the hello, and what its codes stand for.
    for _ in 0..2 {
        device.attend(w, A_WHILE)?;
    }
    loop {
        if w.next(A_WHILE)?.is_some() {
            let asked = w.number;
            w.number = asked.next();
            w.send(&Reply {
                outcome: Outcome::Ok,
                detail: 0,
            })?;
            w.number = asked;
            w.send(&LookupBlob {
                blob: Raw(&[1, 2, 3]),
            })?;
        }
    }
}

fn boots_every_second(w: &mut Wire) -> io::Result<()> {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let mut device = Polite::new(now.map_or(1, |t| t.as_millis() as u32));
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(1) {
        device.attend(w, Duration::from_millis(20))?;
    }
    Ok(())
}

fn damaged_payloads(w: &mut Wire, damage: fn(&mut Vec<u8>)) -> io::Result<()> {
    shaken(w, move |w, k| {
        let entry = &MESSAGES[k as usize % MESSAGES.len()];
        let mut payload = vec![(k % 256) as u8; 40];
        damage(&mut payload);
        w.send_raw(entry.id.unwrap_or(0), &payload)
    })
}

fn status_of_extremes(w: &mut Wire) -> io::Result<()> {
    with_hello(w, |d| {
        let s = &mut d.status;
        (s.state, s.fault) = (State::LockedOut, Fault::from_number(u16::MAX));
        (s.asked_w, s.delivered_mw, s.f_sw_hz) = (u16::MAX, u32::MAX, u32::MAX);
        (s.half_cycles, s.windows_recorded, s.windows_dropped) = (u32::MAX, 0, u32::MAX);
        (s.telemetry_dropped, s.saturated_pairs) = (u32::MAX, u32::MAX);
        (s.heat_sink_c, s.glass_c, s.coil_c) = (i16::MIN, i16::MAX, i16::MIN);
        (s.tries_left, s.panel_level, s.key_locked) = (255, 254, true);
    })
}
