//! The certificate as a Digital Calibration Certificate of the PTB, version 3.3.0, with quantities as D-SI 2.2.1.

use super::xml::Xml;
use super::{AXES, COVERAGE_FACTOR, COVERAGE_PROBABILITY, Certificate, six};
use crate::calibration::certificate::laboratory::Party;

/// Namespaces, schema and its version.
const ROOT: &str = "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xmlns:dcc=\"https://ptb.de/dcc\" \
                    xmlns:si=\"https://ptb.de/si\" xsi:schemaLocation=\"https://ptb.de/dcc \
                    https://ptb.de/dcc/v3.3.0/dcc.xsd\" schemaVersion=\"3.3.0\"";

impl Certificate {
    /// The certificate as XML. `None` if something is missing: a Digital Calibration Certificate has no drafts.
    pub fn dcc(&self) -> Option<String> {
        if !self.laboratory.missing().is_empty() {
            return None;
        }
        let mut xml = Xml::new();
        xml.with("dcc:digitalCalibrationCertificate", ROOT, |xml| {
            xml.element("dcc:administrativeData", |xml| {
                xml.element("dcc:dccSoftware", |xml| self.software(xml));
                self.core_data(xml);
                self.items(xml);
                self.issuer(xml);
                xml.element("dcc:customer", |xml| party(xml, &self.laboratory.customer));
                self.statements(xml);
            });
            xml.element("dcc:measurementResults", |xml| {
                xml.element("dcc:measurementResult", |xml| self.measurement_result(xml));
            });
        });
        Some(xml.finish())
    }

    fn software(&self, xml: &mut Xml) {
        for (what, version) in [
            ("evaluation of the measurement", self.header.version.as_str()),
            ("certificate", env!("CARGO_PKG_VERSION")),
        ] {
            xml.element("dcc:software", |xml| {
                text(xml, "dcc:name", "trifacet");
                xml.leaf("dcc:release", &format!("v{version}"));
                xml.leaf("dcc:type", "application");
                text(xml, "dcc:description", what);
            });
        }
    }

    fn core_data(&self, xml: &mut Xml) {
        let laboratory = &self.laboratory;
        xml.element("dcc:coreData", |xml| {
            leaf(xml, "dcc:countryCodeISO3166_1", laboratory.laboratory.country.as_ref());
            xml.leaf("dcc:usedLangCodeISO639_1", "en");
            xml.leaf("dcc:mandatoryLangCodeISO639_1", "en");
            leaf(xml, "dcc:uniqueIdentifier", laboratory.certificate.number.as_ref());
            leaf(xml, "dcc:receiptDate", laboratory.item.received.as_ref());
            leaf(xml, "dcc:beginPerformanceDate", laboratory.calibration.begun.as_ref());
            leaf(xml, "dcc:endPerformanceDate", laboratory.calibration.ended.as_ref());
            leaf(xml, "dcc:performanceLocation", laboratory.calibration.place.as_ref());
            leaf(xml, "dcc:issueDate", laboratory.certificate.issued.as_ref());
        });
    }

    fn items(&self, xml: &mut Xml) {
        let item = &self.laboratory.item;
        xml.element("dcc:items", |xml| {
            xml.element("dcc:item", |xml| {
                optional(xml, "dcc:name", item.description.as_ref());
                optional(xml, "dcc:description", item.condition.as_ref());
                xml.element("dcc:manufacturer", |xml| optional(xml, "dcc:name", item.manufacturer.as_ref()));
                leaf(xml, "dcc:model", item.model.as_ref());
                xml.element("dcc:identifications", |xml| {
                    identification(xml, "manufacturer", "serial number", item.serial_number.as_deref());
                    identification(
                        xml,
                        "calibrationLaboratory",
                        "fingerprint of the calibrated configuration (SHA-256)",
                        Some(&self.header.fits),
                    );
                    for file in &self.files {
                        let name = format!("SHA-256 of {}", file.name);
                        identification(xml, "calibrationLaboratory", &name, Some(&file.sha256));
                    }
                });
            });
        });
    }

    /// Laboratory and responsible persons.
    fn issuer(&self, xml: &mut Xml) {
        let laboratory = &self.laboratory.laboratory;
        xml.element("dcc:calibrationLaboratory", |xml| {
            leaf(xml, "dcc:calibrationLaboratoryCode", laboratory.accreditation.as_ref());
            xml.element("dcc:contact", |xml| party(xml, laboratory));
        });
        xml.element("dcc:respPersons", |xml| {
            for (i, person) in self.laboratory.certificate.authorized_by.iter().enumerate() {
                xml.element("dcc:respPerson", |xml| {
                    xml.element("dcc:person", |xml| optional(xml, "dcc:name", person.name.as_ref()));
                    leaf(xml, "dcc:role", person.function.as_ref());
                    xml.leaf("dcc:mainSigner", if i == 0 { "true" } else { "false" });
                });
            }
        });
    }

    fn statements(&self, xml: &mut Xml) {
        let (certificate, reference) = (&self.laboratory.certificate, &self.laboratory.reference);
        xml.element("dcc:statements", |xml| {
            let statement = |xml: &mut Xml, words: &str| {
                xml.element("dcc:statement", |xml| text(xml, "dcc:declaration", words));
            };
            statement(xml, super::html::ONLY_THE_ITEM);
            statement(xml, &self.uncertainty_statement());
            statement(xml, super::html::WHY_NO_PARAMETERS);
            xml.element("dcc:statement", |xml| {
                xml.leaf("dcc:traceable", "true");
                optional(xml, "dcc:declaration", reference.traceability.as_ref());
            });
            for remark in certificate.remarks.iter().chain(&self.laboratory.calibration.place_detail) {
                statement(xml, remark);
            }
            for warning in &self.findings.warnings {
                statement(xml, warning);
            }
        });
    }

    fn measurement_result(&self, xml: &mut Xml) {
        text(xml, "dcc:name", "Poses relative to the tare pose");
        text(xml, "dcc:description", &self.measurand());
        xml.element("dcc:usedMethods", |xml| {
            xml.element("dcc:usedMethod", |xml| {
                text(xml, "dcc:name", "Fit of the optical model to measured points");
                text(xml, "dcc:description", &self.method());
                xml.leaf("dcc:norm", "JCGM 100:2008");
                leaf(xml, "dcc:reference", self.laboratory.calibration.procedure.as_ref());
            });
        });
        xml.element("dcc:usedSoftware", |xml| self.software(xml));
        self.equipment(xml);
        self.conditions(xml);
        xml.element("dcc:results", |xml| {
            let after = format!(
                "After adjustment: rms difference from the reference, {} points held out, reference's own uncertainty \
                 included",
                self.findings.held_out.poses
            );
            let before = "Before adjustment: rms difference of the nominal head from the reference";
            for (name, errors) in [(before, &self.findings.before), (after.as_str(), &self.findings.after)] {
                let Some(errors) = errors else { continue };
                result(xml, name, |xml, i| real(xml, six(errors)[i], AXES[i].1, None));
            }
            let name = "Remaining error of the pose relative to the tare pose, all corrections applied";
            result(xml, name, |xml, i| real(xml, 0.0, AXES[i].1, self.expanded()[i]));
        });
    }

    fn equipment(&self, xml: &mut Xml) {
        let reference = &self.laboratory.reference;
        xml.element("dcc:measuringEquipments", |xml| {
            xml.element("dcc:measuringEquipment", |xml| {
                optional(xml, "dcc:name", reference.description.as_ref());
                xml.element("dcc:identifications", |xml| {
                    identification(xml, "manufacturer", "serial number", reference.serial_number.as_deref());
                    let by = reference.certificate_by.as_deref().unwrap_or_default();
                    let name = format!("calibration certificate issued by {by}");
                    identification(xml, "other", &name, reference.certificate.as_deref());
                });
            });
        });
    }

    fn conditions(&self, xml: &mut Xml) {
        let environment = &self.laboratory.environment;
        xml.element("dcc:influenceConditions", |xml| {
            for (name, range, unit) in [
                ("temperature of the air", environment.temperature_c, "\\degreecelsius"),
                ("relative humidity", environment.humidity_percent, "\\percent"),
                ("pressure of the air", environment.pressure_hpa, "\\hecto\\pascal"),
            ] {
                let Some(range) = range else { continue };
                xml.element("dcc:influenceCondition", |xml| {
                    text(xml, "dcc:name", name);
                    xml.element("dcc:data", |xml| {
                        for (which, value) in ["smallest value", "largest value"].into_iter().zip(range) {
                            xml.element("dcc:quantity", |xml| {
                                text(xml, "dcc:name", which);
                                xml.element("si:real", |xml| {
                                    xml.leaf("si:value", &value.to_string());
                                    xml.leaf("si:unit", unit);
                                });
                            });
                        }
                    });
                });
            }
        });
    }
}

/// A result of one quantity for each axis.
fn result(xml: &mut Xml, name: &str, quantity: impl Fn(&mut Xml, usize)) {
    xml.element("dcc:result", |xml| {
        text(xml, "dcc:name", name);
        xml.element("dcc:data", |xml| {
            for (i, (axis, _)) in AXES.into_iter().enumerate() {
                xml.element("dcc:quantity", |xml| {
                    text(xml, "dcc:name", axis);
                    quantity(xml, i);
                });
            }
        });
    });
}

/// A number of micrometres or microradians, with its expanded uncertainty.
fn real(xml: &mut Xml, value: f64, unit: &str, expanded: Option<f64>) {
    xml.element("si:real", |xml| {
        xml.leaf("si:value", &if value == 0.0 { "0".to_owned() } else { format!("{value:.4}") });
        xml.leaf("si:unit", if unit == "um" { "\\micro\\metre" } else { "\\micro\\radian" });
        let Some(expanded) = expanded else { return };
        xml.element("si:measurementUncertaintyUnivariate", |xml| {
            xml.element("si:expandedMU", |xml| {
                xml.leaf("si:valueExpandedMU", &super::rounded_up(expanded));
                xml.leaf("si:coverageFactor", &COVERAGE_FACTOR.to_string());
                xml.leaf("si:coverageProbability", &COVERAGE_PROBABILITY.to_string());
                xml.leaf("si:distribution", "normal");
            });
        });
    });
}

/// Name and address.
fn party(xml: &mut Xml, party: &Party) {
    optional(xml, "dcc:name", party.name.as_ref());
    xml.element("dcc:location", |xml| {
        leaf(xml, "dcc:city", party.city.as_ref());
        leaf(xml, "dcc:countryCode", party.country.as_ref());
        leaf(xml, "dcc:postCode", party.post_code.as_ref());
        leaf(xml, "dcc:street", party.street.as_ref());
    });
}

fn identification(xml: &mut Xml, issuer: &str, name: &str, value: Option<&str>) {
    let Some(value) = value else { return };
    xml.element("dcc:identification", |xml| {
        xml.leaf("dcc:issuer", issuer);
        xml.leaf("dcc:value", value);
        text(xml, "dcc:name", name);
    });
}

/// A text in the language of the certificate.
fn text(xml: &mut Xml, name: &str, words: &str) {
    xml.element(name, |xml| xml.leaf_with("dcc:content", "lang=\"en\"", words));
}

fn optional(xml: &mut Xml, name: &str, words: Option<&String>) {
    if let Some(words) = words {
        text(xml, name, words);
    }
}

fn leaf(xml: &mut Xml, name: &str, words: Option<&String>) {
    if let Some(words) = words {
        xml.leaf(name, words);
    }
}
