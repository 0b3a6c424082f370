"""Pictures of 8 bits with transparency."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from workbench.formats.color_png import read_color_png, write_color_png


def test_pictures_come_back_and_others_read_them(tmp_path):
    picture = np.random.default_rng(5).integers(0, 256, (13, 17, 4), np.uint8)
    path = tmp_path / "a.png"
    write_color_png(path, picture)
    assert np.array_equal(read_color_png(path), picture)
    assert np.array_equal(np.asarray(Image.open(path)), picture)
    first = path.read_bytes()
    write_color_png(path, picture)
    assert path.read_bytes() == first


@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_pictures_without_alpha_are_opaque(tmp_path, mode):
    values = np.random.default_rng(6).integers(
        0, 256, (5, 6, 3) if mode == "RGB" else (5, 6), np.uint8
    )
    Image.fromarray(values).save(tmp_path / "b.png")
    found = read_color_png(tmp_path / "b.png")
    assert (found[..., 3] == 255).all()
    assert np.array_equal(found[..., :3], np.broadcast_to(values.reshape(5, 6, -1), (5, 6, 3)))


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / "c.png").write_bytes(b"no picture at all")
    with pytest.raises(OSError, match="no picture"):
        read_color_png(tmp_path / "c.png")
