//! Spellings of former versions, and the present ones: an old spelling is answered with the new one.

/// Spelling of a former version.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// Commands that had it, each as its words; the empty one is `ihd` itself.
    pub commands: &'static [&'static str],
    /// Subcommand, or flag.
    pub old: &'static str,
    /// Present spelling; `{}` stands for the command.
    pub new: &'static str,
}

const fn moved(commands: &'static [&'static str], old: &'static str, new: &'static str) -> Moved {
    Moved { commands, old, new }
}

/// Commands that start a simulated hob.
const SIM: &[&str] = &["trainer", "hob", "doctor", "record"];

/// Commands that read a capture.
const CAPTURE: &[&str] = &["calibrate", "convert", "identify", "inspect", "replay"];

/// Those of them that survey it.
const SURVEY: &[&str] = &["calibrate", "identify", "inspect", "replay"];

/// Those of them that judge its sensors.
const SENSORS: &[&str] = &["calibrate", "identify", "inspect"];

/// Every spelling that has moved.
pub const MOVED: &[Moved] = &[
    // Commands.
    moved(&[""], "study", "ihd-study (cargo run -p ihd-study)"),
    moved(&[""], "scenario", "ihd simulate FILE.toml"),
    moved(&[""], "completions", "cargo run --example pages -- DIR"),
    moved(&[""], "man", "cargo run --example pages -- DIR"),
    moved(&["trainer"], "serve", "ihd trainer --daemon"),
    moved(&["device"], "list", "ihd device status"),
    moved(&["device"], "sweep", "ihd device DEV power W,W,…"),
    moved(&["device"], "record", "ihd record --device DEV"),
    moved(&["device"], "watch", "ihd watch DEV --lines"),
    moved(
        &["device lookup"],
        "rollback",
        "ihd device DEV lookup push previous",
    ),
    moved(
        &["device lookup"],
        "reset",
        "ihd device DEV lookup push builtin",
    ),
    moved(&["store"], "show", "ihd store ls ID"),
    moved(&["store"], "gc", "ihd store check --collect"),
    // The fleet.
    moved(&["fleet"], "up", "ihd-fleet init up"),
    moved(&["fleet"], "init", "ihd-fleet init"),
    moved(&["fleet"], "server-config", "ihd-fleet init server-config"),
    moved(&["fleet"], "status", "ihd-fleet status"),
    moved(&["fleet"], "devices", "ihd-fleet status devices"),
    moved(&["fleet"], "backlog", "ihd-fleet status backlog"),
    moved(&["fleet"], "dead", "ihd-fleet status dead"),
    moved(&["fleet"], "replay", "ihd-fleet retry"),
    moved(&["fleet lookups"], "ls", "ihd-fleet lookup ls"),
    moved(&["fleet lookups"], "history", "ihd-fleet lookup ls HOB"),
    moved(&["fleet lookups"], "push", "ihd-fleet lookup push HOB FILE"),
    moved(
        &["fleet lookups"],
        "rollback",
        "ihd-fleet lookup push HOB REVISION",
    ),
    moved(&["fleet captures"], "ls", "ihd-fleet capture ls"),
    moved(&["fleet captures"], "put", "ihd-fleet capture put FILE"),
    moved(
        &["fleet captures"],
        "get",
        "ihd-fleet capture get NAME FILE",
    ),
    moved(&[""], "fleet", "ihd-fleet"),
    moved(&[""], "worker", "ihd-fleet worker"),
    // Flags.
    moved(
        &["device status", "device off", "device lookup show"],
        "--force",
        "{} without --force: it needs no lease",
    ),
    moved(&["identify"], "--config", "{} --settings FILE"),
    moved(&["simulate"], "--preset", "{} PRESET"),
    // Keys of --sim.
    moved(SIM, "--lift", "{} --sim lift=M"),
    moved(SIM, "--offset", "{} --sim offset=M"),
    moved(SIM, "--temperature", "{} --sim temperature=CELSIUS"),
    moved(SIM, "--perturb", "{} --sim perturb=NAME"),
    moved(SIM, "--load", "{} --sim load=MODEL"),
    moved(SIM, "--warming", "{} --sim warming"),
    moved(SIM, "--contents", "{} --sim contents=CONTENTS"),
    moved(SIM, "--mains", "{} --sim mains=HZ"),
    moved(SIM, "--bench-supply", "{} --sim bench-supply=V"),
    moved(SIM, "--snr", "{} --sim snr=DB"),
    moved(SIM, "--anti-alias", "{} --sim anti-alias=HZ"),
    moved(SIM, "--seed", "{} --sim seed=N"),
    moved(&["hob"], "--stdin", "{} --script -"),
    moved(&["trainer"], "--backend", "{} --network backend=NAME"),
    moved(&["trainer"], "--no-store", "{} --store none"),
    // Keys of --input.
    moved(CAPTURE, "--channels", "{} --input channels=V,I"),
    moved(CAPTURE, "--columns", "{} --input columns=T,V,I"),
    moved(CAPTURE, "--probe", "{} --input probe=V,I"),
    moved(CAPTURE, "--units", "{} --input units=V,I"),
    moved(CAPTURE, "--invert", "{} --input invert=CHANNELS"),
    moved(CAPTURE, "--swap", "{} --input swap"),
    moved(CAPTURE, "--rate", "{} --input rate=HZ"),
    moved(SURVEY, "--fsw", "{} --input fsw=HZ"),
    moved(SURVEY, "--mains", "{} --input mains=HZ"),
    moved(SURVEY, "--zero-crossing", "{} --input zero-crossing=S"),
    moved(
        SENSORS,
        "--resonance-capacitance",
        "{} --input resonance-capacitance=F",
    ),
    moved(&["identify"], "--backend", "{} --network backend=NAME"),
    moved(
        &["identify"],
        "--deterministic",
        "{} --network deterministic",
    ),
    moved(&["identify"], "--csv", "{} --out FILE.csv"),
    moved(&["identify"], "--plot", "{} --out FILE.svg"),
    // Keys of --set.
    moved(&["simulate"], "--fsw", "{} --set fsw=HZ"),
    moved(&["simulate"], "--sweep", "{} --set sweep=HZ,HZ"),
    moved(&["simulate"], "--duty", "{} --set duty=SHARE"),
    moved(
        &["simulate"],
        "--bridge-resistance",
        "{} --set bridge-resistance=OHM",
    ),
    moved(&["simulate"], "--neighbour", "{} --set neighbour=HZ,V"),
    moved(&["simulate"], "--mains", "{} --set mains=HZ"),
    moved(
        &["simulate"],
        "--distortion",
        "{} --set distortion=PCT,PCT,PCT",
    ),
    moved(
        &["simulate"],
        "--bus-capacitance",
        "{} --set bus-capacitance=F",
    ),
    moved(&["simulate"], "--dead-time", "{} --set dead-time=S"),
    moved(&["simulate"], "--pot", "{} --set pot=POT"),
    moved(&["simulate"], "--lift", "{} --set lift=M"),
    moved(&["simulate"], "--offset", "{} --set offset=M"),
    moved(
        &["simulate"],
        "--temperature",
        "{} --set temperature=CELSIUS",
    ),
    moved(&["simulate"], "--load", "{} --set load=MODEL"),
    moved(&["simulate"], "--winding", "{} --set winding=OHM"),
    moved(&["simulate"], "--start", "{} --set start=S"),
    moved(&["simulate"], "--duration", "{} --set duration=S"),
    moved(&["simulate"], "--step", "{} --set step=S"),
    moved(&["simulate"], "--at", "{} --set at=EVENT"),
    moved(&["simulate"], "--rate", "{} --set rate=HZ"),
    moved(&["simulate"], "--allow-aliasing", "{} --set allow-aliasing"),
    moved(&["simulate"], "--bits", "{} --set bits=N"),
    moved(&["simulate"], "--snr", "{} --set snr=DB"),
    moved(&["simulate"], "--gain", "{} --set gain=V,I"),
    moved(&["simulate"], "--offsets", "{} --set offsets=V,I"),
    moved(&["simulate"], "--pole", "{} --set pole=HZ"),
    moved(&["simulate"], "--poles", "{} --set poles=V,I"),
    moved(&["simulate"], "--droop", "{} --set droop=HZ"),
    moved(&["simulate"], "--saturation", "{} --set saturation=A"),
    moved(&["simulate"], "--full-scale", "{} --set full-scale=V,I"),
    moved(&["simulate"], "--skew", "{} --set skew=S"),
    moved(&["simulate"], "--ringing", "{} --set ringing=SHARE"),
    moved(&["simulate"], "--spikes", "{} --set spikes=RATE"),
];

impl Moved {
    /// Present spelling for one of its commands.
    pub fn spelled(&self, command: &str) -> String {
        self.new.replace("{}", format!("ihd {command}").trim_end())
    }

    /// Command of a command line that uses it, if any: the words of the command come in this order, others (values, names of
    /// devices) between them.
    fn command_in(&self, arguments: &[String]) -> Option<&'static str> {
        let is_flag = self.old.starts_with("--");
        let is_old = |argument: &String| match argument.strip_prefix(self.old) {
            Some(rest) => rest.is_empty() || (is_flag && rest.starts_with('=')),
            None => false,
        };
        self.commands.iter().copied().find(|command| {
            let mut left = arguments.iter();
            let mut words = command.split_whitespace();
            let first = words.next();
            // Options of every command may come before it; their values do not look like commands.
            let is_found = first.is_none_or(|first| {
                left.find(|a| !a.starts_with('-'))
                    .is_some_and(|a| a == first)
            }) && words.all(|word| left.any(|argument| argument == word));
            match first {
                None => left.find(|a| !a.starts_with('-')).is_some_and(is_old),
                Some(_) if is_flag => is_found && arguments.iter().any(is_old),
                Some(_) => is_found && left.any(is_old),
            }
        })
    }
}

/// Answer to a command line that is wrong, if it uses an old spelling.
pub fn answer(arguments: &[String]) -> Option<String> {
    MOVED.iter().find_map(|moved| {
        let command = moved.command_in(arguments)?;
        let old = format!("ihd {command}");
        Some(format!(
            "`{} {}` is `{}` now",
            old.trim_end(),
            moved.old,
            moved.spelled(command)
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answered(line: &str) -> Option<String> {
        let words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        answer(&words)
    }

    #[test]
    fn old_spellings_are_found_among_values_and_names() {
        for (line, new) in [
            ("device bench sweep --power 700", "power W,W,…"),
            ("--json device list", "ihd device status"),
            ("device bench lookup --force rollback", "push previous"),
            ("simulate --preset=paper-50", "ihd simulate PRESET"),
        ] {
            let text = answered(line).unwrap_or_else(|| panic!("{line}: none"));
            assert!(text.contains(new), "{line}: {text}");
        }
    }

    #[test]
    fn present_spellings_are_not() {
        for line in [
            "device bench status",
            "store ls --device list",
            "simulate scenario.toml",
            "hob --script gc",
        ] {
            assert_eq!(answered(line), None, "{line}");
        }
    }
}
