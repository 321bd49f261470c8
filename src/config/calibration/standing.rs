//! Whether the head counts as calibrated, and why not.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use trifacet_core::channels::Channels;

use super::{RecordHeader, SharedSpread, fingerprint};
use crate::config::Config;

/// Seconds per day.
const DAY_S: f64 = 86_400.0;

/// What is known of the calibration of the head.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationState {
    /// The record, if the configuration names one.
    pub record: Option<RecordHeader>,
    /// Whether it is valid.
    pub standing: Standing,
    /// What it leaves unknown of poses, if the record contains it.
    #[serde(skip)]
    pub spread: Option<SharedSpread>,
}

/// Whether a calibration is valid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// The configuration names no record.
    #[default]
    Absent,
    /// The record belongs to another configuration.
    Misfit,
    /// Its time is over.
    Expired,
    /// The record belongs to the configuration.
    Valid,
}

impl CalibrationState {
    /// The calibration of a configuration with this record, at this time. `channels` are those of `config`.
    pub fn of(config: &Config, channels: &Channels, record: Option<RecordHeader>, now: Timestamp) -> Self {
        let standing = match &record {
            None => Standing::Absent,
            Some(record) if record.fits == fingerprint(config, channels) => Standing::Valid,
            Some(_) => Standing::Misfit,
        };
        Self { record, standing, spread: None }.at(now, config.calibration.expires_days)
    }

    /// The same calibration at another time. `expires_days`: as in the configuration.
    #[must_use]
    pub fn at(&self, now: Timestamp, expires_days: Option<f64>) -> Self {
        let over = self.expiry(expires_days).is_some_and(|end| now >= end);
        let standing = match self.standing {
            Standing::Valid | Standing::Expired if over => Standing::Expired,
            Standing::Expired => Standing::Valid, // the limit or the clock was set
            standing => standing,
        };
        Self { standing, ..self.clone() }
    }

    /// Whether the head counts as calibrated.
    pub fn is_valid(&self) -> bool {
        self.standing == Standing::Valid
    }

    /// Whether the record belongs to the configuration, expired or not: it states what is unknown of the geometry.
    pub fn belongs(&self) -> bool {
        matches!(self.standing, Standing::Valid | Standing::Expired)
    }

    /// The end of the calibration: the earlier one of that in the record and that of the configuration.
    pub fn expiry(&self, expires_days: Option<f64>) -> Option<Timestamp> {
        let record = self.record.as_ref()?;
        let stated = record.expires.as_ref().and_then(|time| time.parse().ok());
        let configured = expires_days.and_then(|days| {
            record.time()?.checked_add(SignedDuration::try_from_secs_f64(days * DAY_S).ok()?).ok()
        });
        stated.into_iter().chain(configured).min()
    }

    /// Why the head does not count as calibrated.
    pub fn objection(&self) -> Option<String> {
        let date = self.record.as_ref().map_or("", RecordHeader::day);
        match self.standing {
            Standing::Valid => None,
            Standing::Absent => {
                Some("the configuration names no calibration record (calibration.record)".into())
            }
            Standing::Misfit => Some(format!(
                "the calibration record of {date} belongs to another configuration: geometry, correction tables, \
                 gains or model differ"
            )),
            Standing::Expired => Some(format!("the calibration of {date} has expired")),
        }
    }

    /// The record in words: date with age, method, range and uncertainty, and its end. `None` without a record.
    pub fn describe(&self, now: Timestamp, expires_days: Option<f64>) -> Option<String> {
        let record = self.record.as_ref()?;
        let [x, y, z] = record.std_um;
        let [roll, pitch, yaw] = record.std_urad;
        let end = self.expiry(expires_days).map_or(String::new(), |end| {
            let verb = if now >= end { "expired" } else { "expires" };
            format!("; {verb} {}", day(&end.to_string()))
        });
        Some(format!(
            "{} ({}), {}; over +-{} mm and +-{} mrad: tx {x:.3} ty {y:.3} tz {z:.3} um, roll {roll:.3} pitch \
             {pitch:.3} yaw {yaw:.3} urad{end}",
            record.day(),
            record.time().map_or_else(String::new, |date| age(now, date)),
            record.method,
            record.range_mm,
            record.range_mrad,
        ))
    }
}

impl RecordHeader {
    /// The day of the calibration.
    pub fn day(&self) -> &str {
        day(&self.date)
    }
}

/// The day of a time in RFC 3339.
fn day(time: &str) -> &str {
    time.get(..10).unwrap_or(time)
}

/// Whole days from `date` to `now`.
fn age(now: Timestamp, date: Timestamp) -> String {
    match (now.duration_since(date).as_secs_f64() / DAY_S).floor() {
        days if days < 0.0 => "in the future".into(),
        0.0 => "today".into(),
        1.0 => "1 day ago".into(),
        days => format!("{days} days ago"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse;

    fn record(fits: String, expires: Option<&str>) -> RecordHeader {
        RecordHeader {
            format: 1,
            version: "0.1.0".into(),
            date: "2026-05-04T12:00:00Z".into(),
            method: "six-axis stage".into(),
            fits,
            range_mm: 1.0,
            range_mrad: 5.0,
            std_um: [0.1, 0.1, 0.05],
            std_urad: [0.3, 0.3, 0.2],
            expires: expires.map(str::to_owned),
            at_calibration: None,
        }
    }

    fn standing(text: &str, fits: bool, expires: Option<&str>, now: &str) -> CalibrationState {
        let config = parse(text, None).unwrap();
        let channels = config.read_channels().unwrap();
        let fits = if fits { fingerprint(&config, &channels) } else { "0123".into() };
        CalibrationState::of(&config, &channels, Some(record(fits, expires)), now.parse().unwrap())
    }

    #[test]
    fn only_a_record_of_the_configuration_counts_and_only_until_its_end() {
        let in_may = "2026-05-05T12:30:00Z";
        assert!(standing("", true, None, in_may).is_valid());
        let misfit = standing("", false, None, in_may);
        assert_eq!(misfit.standing, Standing::Misfit);
        assert!(misfit.objection().unwrap().contains("of 2026-05-04 belongs to another configuration"));
        for (text, expires, days) in [
            ("calibration.expires_days = 30", None, 30),
            ("calibration.expires_days = 30", Some("2026-05-24T12:00:00Z"), 20),
            ("calibration.expires_days = 10", Some("2026-05-24T12:00:00Z"), 10),
            ("", Some("2026-05-24T12:00:00Z"), 20),
        ] {
            let date: Timestamp = "2026-05-04T12:00:00Z".parse().unwrap();
            let end = date + SignedDuration::from_hours(24 * days);
            let before = (end - SignedDuration::from_secs(1)).to_string();
            assert!(standing(text, true, expires, &before).is_valid(), "{text} {expires:?}");
            let after = standing(text, true, expires, &end.to_string());
            assert_eq!(after.objection().unwrap(), "the calibration of 2026-05-04 has expired");
            let days = parse(text, None).unwrap().calibration.expires_days;
            assert!(after.at(date, days).is_valid(), "the clock was set back");
            assert_eq!(misfit.at(end, days).standing, Standing::Misfit);
        }
    }

    #[test]
    fn a_record_is_described_with_its_age() {
        let calibration = standing("", true, Some("2026-05-24T12:00:00Z"), "2026-05-05T12:30:00Z");
        assert_eq!(
            calibration.describe("2026-05-07T11:00:00Z".parse().unwrap(), None).unwrap(),
            "2026-05-04 (2 days ago), six-axis stage; over +-1 mm and +-5 mrad: tx 0.100 ty 0.100 tz 0.050 um, \
             roll 0.300 pitch 0.300 yaw 0.200 urad; expires 2026-05-24"
        );
    }
}
