"""Parses /metrics from standard input with the Prometheus library and prints it as JSON."""

import json
import sys

from prometheus_client.openmetrics.parser import text_string_to_metric_families

SUFFIX = {"counter": "_total", "info": "_info"}

print(json.dumps([
    {
        "name": family.name + SUFFIX.get(family.type, ""),
        "type": family.type,
        "meaning": family.documentation,
        "samples": [[sample.name, sample.labels, sample.value] for sample in family.samples],
    }
    for family in text_string_to_metric_families(sys.stdin.read())
]))
