"""No stage takes more memory than it announced before it ran."""

import pytest

from stages.main import PIPELINE
from tests.benchmarks.bench_memory import measured, simulated
from workbench.pipeline.stage import LIBRARY_BYTES, Estimate


def test_each_further_worker_takes_an_item_and_its_libraries():
    estimate = Estimate(1000, 0, item_bytes=300)
    assert estimate.announced(1) == 1000 + LIBRARY_BYTES
    assert estimate.announced(3) == 1600 + 3 * LIBRARY_BYTES
    assert Estimate(1000, 0).announced(3) == 1000 + LIBRARY_BYTES


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_peaks_stay_below_what_was_announced(tmp_path, workers):
    rows = measured(simulated(tmp_path / "statue", "small", 24, workers))
    assert {row.stage for row in rows} == {stage.name for stage in PIPELINE}
    assert {row.stage: row.share for row in rows if row.share > 1.0} == {}
