"""Judges a Digital Calibration Certificate: Schematron of the PTB, elements that ISO/IEC 17025 needs."""

import json
import sys

from dcclib.validation.schematron import SchematronValidator
from lxml import etree

NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
NEEDED = [
    "dcc:administrativeData/dcc:dccSoftware/dcc:software/dcc:release",
    "dcc:administrativeData/dcc:coreData/dcc:uniqueIdentifier",
    "dcc:administrativeData/dcc:coreData/dcc:receiptDate",
    "dcc:administrativeData/dcc:coreData/dcc:beginPerformanceDate",
    "dcc:administrativeData/dcc:coreData/dcc:endPerformanceDate",
    "dcc:administrativeData/dcc:coreData/dcc:performanceLocation",
    "dcc:administrativeData/dcc:coreData/dcc:issueDate",
    "dcc:administrativeData/dcc:items/dcc:item/dcc:identifications/dcc:identification/dcc:value",
    "dcc:administrativeData/dcc:calibrationLaboratory/dcc:contact/dcc:location/dcc:city",
    "dcc:administrativeData/dcc:respPersons/dcc:respPerson/dcc:person/dcc:name",
    "dcc:administrativeData/dcc:statements/dcc:statement/dcc:traceable",
    "dcc:measurementResults/dcc:measurementResult/dcc:usedMethods/dcc:usedMethod",
    "dcc:measurementResults/dcc:measurementResult/dcc:measuringEquipments/dcc:measuringEquipment",
    "dcc:measurementResults/dcc:measurementResult/dcc:influenceConditions/dcc:influenceCondition",
]


def main(path):
    tree = etree.parse(path)
    result = SchematronValidator.for_dcc().validate_file(path)
    judged = result.failed_assertions + result.successful_reports
    found = [" ".join(f"{x.role}: {x.text}".split()) for x in judged if x.role in ("error", "warning")]
    root = tree.getroot()
    name = root.find("dcc:administrativeData/dcc:customer/dcc:name/dcc:content", NAMESPACES)
    expanded = root.findall(".//si:expandedMU/si:valueExpandedMU", NAMESPACES)
    answer = {
        "findings": found,
        "rules_applied": len(judged),
        "customer": name.text,
        "missing": [path for path in NEEDED if root.find(path, NAMESPACES) is None],
        "expanded": [float(value.text) for value in expanded],
    }
    print(json.dumps(answer))


main(sys.argv[1])
