import numpy as np
import pytest

from workbench.errors import SettingsError
from workbench.surfels.surfel_size import FoveaZones, SizeControl


def test_the_size_follows_the_papers_formula():
    control = SizeControl(target_s=0.01)

    # (3 · 2 + 2 · 2) / 4
    assert control.next_px([2.0, 2.0, 2.0], 0.02) == pytest.approx(2.5)
    # The mean of the last three counts, not what was before.
    assert control.next_px([9.0, 1.0, 2.0, 3.0], 0.02) == pytest.approx(2.5)
    assert control.next_px([2.0], 0.005) == pytest.approx(1.75)


def test_small_deviations_change_nothing_and_bounds_hold():
    control = SizeControl(target_s=0.01)

    assert control.next_px([3.0], 0.0109) == 3.0
    assert control.next_px([3.0], 0.0091) == 3.0
    assert control.next_px([3.0], 0.0112) > 3.0
    assert control.next_px([7.0], 1.0) == 8.0
    assert control.next_px([1.1], 0.0) == 1.0


def test_a_load_that_goes_with_the_surfels_settles_at_the_frame_rate():
    control, sizes = SizeControl(target_s=0.01), [1.0]

    def seconds(size):
        return 0.09 / size**2  # Surfels go with the inverse square of their size.

    for _ in range(60):
        sizes.append(control.next_px(sizes, seconds(sizes[-1])))

    assert 0.88 * 0.01 < seconds(sizes[-1]) < 1.12 * 0.01
    assert sizes[-1] == pytest.approx(sizes[-5])


def test_zones_grow_linearly_between_their_radii():
    zones = FoveaZones((100.0, 50.0), (10.0, 30.0), (1.0, 3.0))

    places = np.array([[100, 50], [110, 50], [100, 70], [130, 50], [900, 50]])
    np.testing.assert_allclose(zones.factor(places), [1, 1, 2, 3, 3])


@pytest.mark.parametrize(
    "make",
    [
        lambda: SizeControl(0.0),
        lambda: SizeControl(0.01, 4.0, 2.0),
        lambda: FoveaZones((0, 0), (), ()),
        lambda: FoveaZones((0, 0), (10, 5), (1, 2)),
        lambda: FoveaZones((0, 0), (10, 20), (1,)),
        lambda: FoveaZones((0, 0), (10,), (0.5,)),
    ],
)
def test_settings_that_contradict_each_other_are_refused(make):
    with pytest.raises(SettingsError):
        make()
