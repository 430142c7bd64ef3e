//! Documented calls that are not run word for word, or that do not end by themselves with exit code 0: what is done instead, and why.

/// End of a call that works.
#[derive(Clone, Copy)]
pub enum End {
    /// By itself, with one of these exit codes.
    Codes(&'static [i32]),
    /// By ^C with 0, once standard output has this.
    Shows(&'static str),
    /// By itself after a long time, and here by ^C, once standard output has this.
    Begins(&'static str),
    /// By ^C with 0 after all that follows it, which needs it; standard error has this when it works.
    Serves(&'static str),
    /// By `q` with 0, once its terminal has this.
    Draws(&'static str),
    /// By itself with 0, once its terminal has asked this and got that.
    Asks(&'static str, &'static str),
    /// By itself with 0 after so many seconds of heating as it takes to begin: the words' last one.
    Heats,
}

/// A call and what is special about it.
pub struct Special {
    /// The call as documented.
    pub call: &'static str,
    /// Words and what stands in for them.
    pub instead: &'static [(&'static str, &'static str)],
    /// Words that are added.
    pub more: &'static str,
    pub end: End,
    /// A part of what it says, on either output.
    pub says: &'static str,
    /// `true` if the daemon of the other terminal must have ended.
    pub is_alone: bool,
}

pub const PLAIN: Special = Special {
    call: "",
    instead: &[],
    more: "",
    end: End::Codes(&[0]),
    says: "",
    is_alone: false,
};

/// A probe that there is not: one that is plugged in here, with somebody's board behind it, is left alone.
const NO_PROBE: &str = "--probe 1209:0000:none --image board.elf";

/// Without the feature, a probe is wrong usage that names the feature.
const WITHOUT_PROBE: End = End::Codes(if cfg!(feature = "probe") { &[3] } else { &[2] });

/// The simulated hob on a bench supply.
const BENCH_SUPPLY: &str = "sim --sim bench-supply=40";

/// Words that mean the same wherever they stand. The addresses of hobs, `tcp:` and `serial:`, are found by [`super::desk`].
pub const STAND_INS: [(&str, &str); 4] = [
    ("usb", "sim"),
    ("DEV", "bench"),
    // A capture of one's own.
    ("FILE", "scope.csv"),
    ("/backup/ihd-store", "backup"),
];

pub const SPECIAL: &[Special] = &[
    // The results of some methods are refused on this capture, as the document says.
    Special {
        call: "ihd identify a.mcap --method all",
        end: End::Codes(&[7]),
        says: "least-squares: gate: pass",
        ..PLAIN
    },
    // What is found depends on the machine of the test, and on what is plugged in there; nothing is switched.
    Special {
        call: "ihd doctor",
        end: End::Codes(&[0, 1, 3]),
        says: "serial_ports",
        ..PLAIN
    },
    Special {
        call: "ihd doctor serial:/dev/ttyACM0",
        end: End::Codes(&[0, 1]),
        says: "link_from_device  pass",
        ..PLAIN
    },
    // It would change this machine: the answer is no.
    Special {
        call: "ihd doctor --fix",
        end: End::Asks("Type `yes`", "no"),
        says: "nothing was done",
        ..PLAIN
    },
    Special {
        call: "ihd doctor tcp:127.0.0.1:4799 --first-switching --yes",
        end: End::Codes(&[0, 1]),
        says: "resonance         pass",
        ..PLAIN
    },
    Special {
        call: "ihd doctor usb --first-switching",
        instead: &[("usb", BENCH_SUPPLY)],
        end: End::Asks("Type `switch`", "switch"),
        says: "resonance         pass",
        ..PLAIN
    },
    // The simulated load is another one.
    Special {
        call: "ihd doctor serial:/dev/ttyACM0 --first-switching --reference r=4.7,l=30u",
        instead: &[
            ("serial:/dev/ttyACM0", BENCH_SUPPLY),
            ("r=4.7,l=30u", "r=7.11,l=28.9u"),
        ],
        end: End::Asks("Type `switch`", "switch"),
        says: "skew              pass",
        ..PLAIN
    },
    Special {
        call: "ihd flash",
        more: NO_PROBE,
        end: WITHOUT_PROBE,
        says: "probe",
        ..PLAIN
    },
    Special {
        call: "ihd flash --set-option-bytes",
        more: NO_PROBE,
        end: WITHOUT_PROBE,
        says: "probe",
        ..PLAIN
    },
    // A bootloader and a port that there are not, for the same reason.
    Special {
        call: "ihd flash --dfu",
        instead: &[("--dfu", "--dfu=NONE")],
        more: "--image board.elf",
        end: End::Codes(&[3]),
        says: "USB",
        ..PLAIN
    },
    Special {
        call: "ihd flash --dfu --device serial:/dev/ttyUSB0",
        instead: &[
            ("--dfu", "--dfu=NONE"),
            ("serial:/dev/ttyUSB0", "serial:/dev/none"),
        ],
        more: "--image board.elf",
        end: End::Codes(&[3]),
        says: "",
        ..PLAIN
    },
    Special {
        call: "ihd flash --dfu=205939885533",
        more: "--image board.elf",
        end: End::Codes(&[3]),
        says: "USB",
        ..PLAIN
    },
    // A board that is plugged in here may heat for another host, whose power a hello would end: one that says what it is told to.
    Special {
        call: "ihd log",
        more: "{board} --image board.elf",
        end: End::Shows("watchdog runs: 60000 µs"),
        ..PLAIN
    },
    Special {
        call: "ihd log serial:/dev/ttyACM0",
        instead: &[("serial:/dev/ttyACM0", "{board}")],
        more: "--image board.elf",
        end: End::Shows("watchdog runs: 60000 µs"),
        ..PLAIN
    },
    Special {
        call: "ihd log --probe",
        instead: &[("--probe", "--probe=1209:0000:none")],
        end: WITHOUT_PROBE,
        says: "probe",
        ..PLAIN
    },
    // The field model computes fifty times as long as it simulates.
    Special {
        call: "ihd simulate paper-45 --out a.mcap",
        more: "--set duration=10ms",
        ..PLAIN
    },
    Special {
        call: "ihd simulate paper-45 --out paper-45.mcap --plot paper-45.svg",
        more: "--set duration=5ms",
        ..PLAIN
    },
    Special {
        call: "ihd simulate --set fsw=45k,mains=50,pot=ferritic-18,snr=30,rate=50M --seed 1",
        more: "--set duration=5ms",
        ..PLAIN
    },
    Special {
        call: "ihd simulate --approximations",
        end: End::Begins("dR/%"),
        ..PLAIN
    },
    // A scenario of three seconds, which has a test of its own.
    Special {
        call: "ihd simulate tests/scenarios/lift/lift.toml",
        instead: &[(
            "tests/scenarios/lift/lift.toml",
            "tests/scenarios/link/small.toml",
        )],
        ..PLAIN
    },
    // It records until ^C.
    Special {
        call: "ihd record --device usb --power 1000 --out kitchen.mcap",
        more: "--duration 1s",
        says: "4 received",
        ..PLAIN
    },
    Special {
        call: "ihd record --device tcp:127.0.0.1:4711 --power 1500 --duration 60s --max-size 200M --out long.mcap",
        instead: &[("60s", "1s")],
        ..PLAIN
    },
    Special {
        call: "ihd record --device bench --duration 30",
        instead: &[("30", "1")],
        ..PLAIN
    },
    Special {
        call: "ihd record --device bench --trigger fault --pre-trigger 10 --duration 30",
        instead: &[("10", "1"), ("30", "1")],
        says: "its trigger came",
        ..PLAIN
    },
    // It records until ^C.
    Special {
        call: "ihd record --device bench --trigger level:power>1000 --pre-trigger 5 --out run.mcap",
        instead: &[("5", "1")],
        more: "--duration 1",
        says: "its trigger came",
        ..PLAIN
    },
    // A capture of four channels.
    Special {
        call: "ihd convert scope.csv --input channels=CH1,CH3,probe=100,10,invert=i --out capture.npz",
        instead: &[("scope.csv", "four.csv")],
        ..PLAIN
    },
    // The fixtures of this format are too short to show a switching frequency: two files of a channel each, known by their content.
    Special {
        call: "ihd replay coil_v.wfm coil_i.wfm --device tcp:127.0.0.1:4711 --speed 1 --json",
        instead: &[("coil_v.wfm", "coil_v.csv"), ("coil_i.wfm", "coil_i.csv")],
        says: "\"differences\": 0",
        ..PLAIN
    },
    Special {
        call: "ihd device serial:/dev/ttyACM0 power 600 --for 60",
        end: End::Heats,
        ..PLAIN
    },
    Special {
        call: "ihd trainer --daemon",
        end: End::Serves("state=\"connected\""),
        ..PLAIN
    },
    Special {
        call: "ihd trainer --daemon --config ihd.toml",
        end: End::Serves("state=\"connected\""),
        ..PLAIN
    },
    Special {
        call: "ihd trainer --ui",
        end: End::Shows("the page is http://"),
        is_alone: true,
        ..PLAIN
    },
    Special {
        call: "ihd watch",
        end: End::Draws("bench"),
        ..PLAIN
    },
    Special {
        call: "ihd watch bench",
        end: End::Draws("bench"),
        ..PLAIN
    },
    // Whoever reads the store next finds a result in it.
    Special {
        call: "ihd watch DEV --lines --json",
        end: End::Shows("\"result-stored\""),
        ..PLAIN
    },
    Special {
        call: "ihd store ls 4711",
        instead: &[("4711", "1")],
        ..PLAIN
    },
    Special {
        call: "ihd store check --collect",
        is_alone: true,
        ..PLAIN
    },
];
