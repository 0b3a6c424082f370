"""Whether photographs were taken with a flash, where their files do not tell."""

from types import SimpleNamespace

import numpy as np
import pytest

from stages.color import flashing
from stages.color.options import ColorOptions
from workbench.color.flash_light import FlashLight


@pytest.fixture
def found(monkeypatch):
    """A function from what is told and the scatters, alone and with a flash, to what is found."""

    def find(told: bool, with_gains: float, held_out: float) -> flashing.FoundFlash:
        estimate = SimpleNamespace(
            light=FlashLight(np.array([0.1, -0.1, 0.0])),
            gains=np.array([0.9, 1.1]),
            scatter_with_gains=with_gains,
            scatter_held_out=held_out,
        )
        monkeypatch.setattr(flashing, "_estimated", lambda *_: estimate)
        job = SimpleNamespace(options=ColorOptions())
        return flashing.found_flash(job, SimpleNamespace(names=("a", "b")), None, told=told)

    return find


def test_a_flash_fitted_to_daylight_is_left_out_and_told(found):
    # The church fountain of Strecha: 4.33 % with a strength each, 4.44 % with a flash besides.
    flash = found(False, 0.0433, 0.0444)
    assert (flash.light, flash.way, flash.gains) == (None, "left out", {"a": 1.0, "b": 1.0})
    assert "4.4 % with one and by 4.3 % without" in flash.reason


@pytest.mark.parametrize(
    ("told", "with_gains", "held_out"), [(False, 0.109, 0.051), (True, 0.0433, 0.0444)]
)
def test_one_that_shows_or_is_told_of_is_kept(
    found, told: bool, with_gains: float, held_out: float
):
    flash = found(told, with_gains, held_out)
    assert flash.light is not None
    assert (flash.way, flash.gains) == ("estimated", {"a": 0.9, "b": 1.1})
