from __future__ import annotations

import json

import pytest

from workbench.verification.provenance import provenance_document


@pytest.fixture
def document(records) -> dict:
    return provenance_document("Bust, inv. 12/3", records, "0.1.0")


def test_stages_that_ran_are_activities_and_left_out_ones_are_not(document):
    assert set(document["activity"]) == {
        "project:stage-ingest",
        "project:stage-register",
        "project:stage-infill",
    }
    activity = document["activity"]["project:stage-register"]
    assert activity["prov:startTime"] == "2025-03-04T10:01:00+00:00"
    assert activity["prov:endTime"] == "2025-03-04T10:01:30+00:00"


def test_every_relation_names_what_exists(document):
    kinds = {
        "prov:activity": "activity",
        "prov:entity": "entity",
        "prov:generatedEntity": "entity",
        "prov:usedEntity": "entity",
        "prov:agent": "agent",
        "prov:plan": "entity",
    }
    for relation in ("used", "wasGeneratedBy", "wasAssociatedWith", "wasDerivedFrom"):
        assert document[relation]
        for attributes in document[relation].values():
            for key, kind in kinds.items():
                assert key not in attributes or attributes[key] in document[kind]


def test_an_output_is_the_same_entity_when_the_next_stage_reads_it(document):
    generated = {
        relation["prov:entity"]: relation["prov:activity"]
        for relation in document["wasGeneratedBy"].values()
    }
    used = {
        (relation["prov:activity"], relation["prov:entity"])
        for relation in document["used"].values()
    }
    chained = [(activity, entity) for activity, entity in used if entity in generated]
    assert ("project:stage-register", generated_by(generated, "ingest")) in chained
    derived = {
        (relation["prov:generatedEntity"], relation["prov:usedEntity"])
        for relation in document["wasDerivedFrom"].values()
    }
    assert (generated_by(generated, "register"), generated_by(generated, "ingest")) in derived


def generated_by(generated: dict[str, str], stage: str) -> str:
    return next(entity for entity, by in generated.items() if by == f"project:stage-{stage}")


def test_the_same_path_with_other_bytes_is_another_entity(records):
    changed = json.loads(json.dumps(records))
    changed[1]["inputs"][0]["hash"] = "blake2b:" + "f" * 32
    entities = provenance_document("p", changed, "1")["entity"]
    assert len(entities) == len(provenance_document("p", records, "1")["entity"]) + 1


def test_agents_carry_their_versions(document):
    versions = {agent["prov:label"]: agent["wb:version"] for agent in document["agent"].values()}
    assert versions["scan-workbench 0.1.0"] == "0.1.0"
    assert versions["open3d 0.20.0"] == "0.20.0"


def test_the_document_is_the_same_every_time(records):
    first, second = (json.dumps(provenance_document("p", records, "1")) for _ in range(2))
    assert first == second


def test_an_independent_prov_library_reads_it_and_keeps_all(document):
    model = pytest.importorskip("prov.model")
    read = model.ProvDocument.deserialize(content=json.dumps(document), format="json")
    for kind, cls in (
        ("entity", model.ProvEntity),
        ("activity", model.ProvActivity),
        ("agent", model.ProvAgent),
        ("used", model.ProvUsage),
        ("wasGeneratedBy", model.ProvGeneration),
        ("wasAssociatedWith", model.ProvAssociation),
        ("wasDerivedFrom", model.ProvDerivation),
    ):
        assert len(list(read.get_records(cls))) == len(document[kind]), kind
    again = model.ProvDocument.deserialize(content=read.serialize(format="json"), format="json")
    assert again == read
    activity = next(
        record
        for record in read.get_records(model.ProvActivity)
        if record.identifier.localpart == "stage-register"
    )
    assert activity.get_startTime().isoformat() == "2025-03-04T10:01:00+00:00"
