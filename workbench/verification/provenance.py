"""The history of a model as W3C PROV, in its JSON form (PROV-JSON, W3C submission 2013).

Files are entities, stages that ran are activities, the workbench and its libraries are
agents. A stage that was left out did not happen and so is not told.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any
from urllib.parse import quote

from workbench.metrics import Metric

_TERMS = "urn:x-scan-workbench:terms:"
_PROJECT = "urn:x-scan-workbench:project:"
_DISTRIBUTION = "scan-workbench"
# Enough of a content hash to tell the versions of one file apart in an identifier.
_HASH_DIGITS = 16
# What a record says of a library that was asked for and not there.
_ABSENT = "not installed"


def provenance_document(
    project_name: str,
    records: Sequence[Mapping[str, Any]],
    workbench_version: str | None = None,
) -> dict[str, Any]:
    """The PROV-JSON document of a project.

    Parameters
    ----------
    project_name
        as the user wrote it; part of the namespace of all identifiers.
    records
        of the stages, as their record files hold them, in the order of the run.
        Those without a start time (left out, never run) are passed over.
    workbench_version
        version of this software; by default that of the installed package.

    Returns
    -------
    Plain data for ``json.dump``: ``prefix``, ``entity``, ``activity``, ``agent`` and the
    relations ``used``, ``wasGeneratedBy``, ``wasAssociatedWith``, ``wasDerivedFrom``.
    """
    if workbench_version is None:
        workbench_version = _installed_version()
    document: dict[str, Any] = {
        "prefix": {
            "xsd": "http://www.w3.org/2001/XMLSchema#",
            "wb": _TERMS,
            "project": f"{_PROJECT}{quote(project_name, safe='')}:",
        },
        "entity": {},
        "activity": {},
        "agent": {},
        "used": {},
        "wasGeneratedBy": {},
        "wasAssociatedWith": {},
        "wasDerivedFrom": {},
    }
    workbench = _software(document, _DISTRIBUTION, workbench_version)
    for record in records:
        if record.get("started"):
            _tell(document, record, workbench)
    return document


def _tell(document: dict[str, Any], record: Mapping[str, Any], workbench: str) -> None:
    """Add one stage with its files, settings, agents and relations."""
    stage = record["stage"]
    activity = f"project:stage-{_local(stage)}"
    document["activity"][activity] = _activity(record)

    settings = f"project:settings-{_local(stage)}"
    document["entity"][settings] = {
        "prov:type": _name("prov:Plan"),
        "prov:label": f"settings of {stage}",
        "wb:options": json.dumps(record.get("options", {}), sort_keys=True, ensure_ascii=False),
    }
    _relate(
        document,
        "wasAssociatedWith",
        {"prov:activity": activity, "prov:agent": workbench, "prov:plan": settings},
    )
    for library, version in sorted(record.get("libraries", {}).items()):
        if library != _DISTRIBUTION and version != _ABSENT:
            agent = _software(document, library, version)
            _relate(document, "wasAssociatedWith", {"prov:activity": activity, "prov:agent": agent})

    inputs = [_file(document, entry) for entry in record.get("inputs", ())]
    outputs = [_file(document, entry) for entry in record.get("outputs", ())]
    for entity in inputs:
        _relate(document, "used", {"prov:activity": activity, "prov:entity": entity})
    for entity in outputs:
        generation = {"prov:entity": entity, "prov:activity": activity}
        if record.get("ended"):
            generation["prov:time"] = record["ended"]
        _relate(document, "wasGeneratedBy", generation)
        for source in inputs:
            _relate(
                document,
                "wasDerivedFrom",
                {
                    "prov:generatedEntity": entity,
                    "prov:usedEntity": source,
                    "prov:activity": activity,
                },
            )


def _activity(record: Mapping[str, Any]) -> dict[str, Any]:
    told: dict[str, Any] = {
        "prov:type": _name("wb:Stage"),
        "prov:label": record["stage"],
        "prov:startTime": record["started"],
        "wb:state": record["state"],
    }
    if record.get("ended"):
        told["prov:endTime"] = record["ended"]
    for key, term, kind in (
        ("version", "wb:stageVersion", "xsd:int"),
        ("seconds", "wb:seconds", "xsd:double"),
        ("cpu_seconds", "wb:cpuSeconds", "xsd:double"),
        ("peak_rss_bytes", "wb:peakMemoryBytes", "xsd:long"),
    ):
        if record.get(key) is not None:
            told[term] = _typed(record[key], kind)
    if record.get("reason"):
        told["wb:reason"] = record["reason"]
    if record.get("warnings"):
        told["wb:warning"] = list(record["warnings"])
    if record.get("host"):
        told["wb:host"] = json.dumps(record["host"], sort_keys=True, ensure_ascii=False)
    for plain in record.get("metrics", ()):
        metric = Metric.from_dict(plain)
        unit = f" {metric.unit}" if metric.unit else ""
        told[f"wb:metric-{_local(metric.name)}"] = f"{metric.value}{unit}"
    return told


def _file(document: dict[str, Any], entry: Mapping[str, Any]) -> str:
    """The identifier of a file's content; the same path with other bytes is another entity."""
    digits = entry["hash"].rsplit(":", 1)[-1][:_HASH_DIGITS]
    identifier = f"project:{_local(entry['path'])}-{digits}"
    document["entity"].setdefault(
        identifier,
        {
            "prov:type": _name("wb:File"),
            "prov:label": entry["artefact"],
            "wb:path": entry["path"],
            "wb:contentHash": entry["hash"],
            "wb:bytes": _typed(entry["bytes"], "xsd:long"),
        },
    )
    return identifier


def _software(document: dict[str, Any], name: str, version: str) -> str:
    identifier = f"wb:{_local(name)}-{_local(version)}"
    document["agent"].setdefault(
        identifier,
        {
            "prov:type": _name("prov:SoftwareAgent"),
            "prov:label": f"{name} {version}",
            "wb:version": version,
        },
    )
    return identifier


def _relate(document: dict[str, Any], relation: str, attributes: dict[str, str]) -> None:
    # Blank names, numbered within their kind: a relation is never referred to.
    relations = document[relation]
    relations[f"_:{relation}{len(relations) + 1}"] = attributes


def _name(qualified: str) -> dict[str, str]:
    return {"$": qualified, "type": "prov:QUALIFIED_NAME"}


def _typed(value: float | int, kind: str) -> dict[str, str]:
    return {"$": str(value), "type": kind}


def _local(text: str) -> str:
    """Text as the local part of a qualified name; told apart by hash or path where it matters."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip(".-") or "_"


def _installed_version() -> str:
    try:
        return metadata.version(_DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return "unknown"
