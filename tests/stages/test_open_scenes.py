"""A surface that was closed though the scene is open: what is said of it."""

from stages.infill import open_scene


def test_a_facade_is_told_how_to_stay_open():
    (said,) = open_scene(0.122, 0.0112)
    assert "only 12 % of the surface was measured" in said
    assert "infill.trim_distance_m=0.2 keeps" in said


def test_a_statue_with_holes_is_left_alone():
    assert open_scene(0.76, 0.001) == []
