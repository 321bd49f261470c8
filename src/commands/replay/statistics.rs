//! Statistics of the differences between poses with two configurations.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use trifacet::replay::comparison::Pair;
use trifacet_wire::Status;

const AXES: [(&str, &str); 6] =
    [("tx", "um"), ("ty", "um"), ("tz", "um"), ("roll", "urad"), ("pitch", "urad"), ("yaw", "urad")];

/// Sums over frames that have a pose in the recording and in the replay.
#[derive(Debug, Default)]
pub(super) struct Statistics {
    both: u64,
    only_then: u64,
    only_now: u64,
    neither: u64,
    sum: [f64; 6],
    squares: [f64; 6],
    most: [f64; 6],
    /// Number of frames without a pose in the replay, by the status bits that give the reason.
    why: BTreeMap<u32, u64>,
}

impl Statistics {
    pub(super) fn push(&mut self, pair: &Pair<'_>) {
        match [pair.then, &pair.now].map(|frame| !frame.pose[0].is_nan()) {
            [true, true] => {}
            [true, false] => {
                *self.why.entry(pair.now.status.0 & Status::FATAL.0).or_default() += 1;
                return self.only_then += 1;
            }
            [false, true] => return self.only_now += 1,
            [false, false] => return self.neither += 1,
        }
        self.both += 1;
        for i in 0..6 {
            let difference = pair.now.pose[i] - pair.then.pose[i];
            self.sum[i] += difference;
            self.squares[i] += difference * difference;
            self.most[i] = self.most[i].max(difference.abs());
        }
    }

    /// The statistics as text.
    pub(super) fn text(&self, same: u64) -> String {
        let Self { both, only_then, only_now, neither, .. } = self;
        let mut text = format!(
            "{both} frames have a pose then and now, {only_then} only then, {only_now} only now, {neither} neither; \
             {same} are identical, bit by bit\n"
        );
        if let Some((bits, n)) = self.why.iter().max_by_key(|(_, n)| **n) {
            let names: Vec<_> = Status(*bits).names().collect();
            let _ = writeln!(text, "of those without a pose now, {n} have {}", names.join(" "));
        }
        if *both > 0 {
            text.push_str("now minus then:\n");
            let n = *both as f64;
            for (i, (axis, unit)) in AXES.into_iter().enumerate() {
                let [mean, rms, most] =
                    [self.sum[i] / n, (self.squares[i] / n).sqrt(), self.most[i]].map(|x| x * 1e6);
                // Writing to a String cannot fail.
                let _ = writeln!(text, "{axis:<6} mean {mean:+.6} {unit}, rms {rms:.6}, at most {most:.6}");
            }
        }
        text
    }
}
