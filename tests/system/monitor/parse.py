"""Parses /metrics from standard input with the Prometheus library and prints it as JSON.

The argument is the format, "openmetrics" or "text". The names of families are those of the text format.
"""

import json
import sys

if sys.argv[1] == "openmetrics":
    from prometheus_client.openmetrics.parser import text_string_to_metric_families
else:
    from prometheus_client.parser import text_string_to_metric_families

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
