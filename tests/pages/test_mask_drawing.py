"""The shapes that are drawn, against NumPy, and changes that are undone: mask.js in a browser."""

from __future__ import annotations

import numpy as np
import pytest

WIDTH, HEIGHT = 61, 47
Y, X = np.mgrid[:HEIGHT, :WIDTH] + 0.5
# Pixels whose centres lie so close to an edge may fall to either side.
EDGE = 1e-9


@pytest.fixture(scope="module")
def shape(browser):
    """A function that runs JavaScript on a fresh ``mask`` and gives its pixels."""
    from workbench.pages.server import static_files

    tab = browser.new_page()
    files = static_files("mask_editor")

    def answer(route):
        file = files[route.request.url.rsplit("/", 1)[1]]
        body = b"<!doctype html>" if file is files[""] else file.content
        route.fulfill(body=body, content_type=file.media_type)

    tab.route("http://127.0.0.1:9/**", answer)
    tab.goto("http://127.0.0.1:9/")

    def run(script, argument=None, result="[...mask.data]"):
        return tab.evaluate(
            f"""async (a) => {{
                const {{ Mask }} = await import("/mask.js");
                const {{ History }} = await import("/history.js");
                const {{ packed, unpacked }} = await import("/codec.js");
                const mask = new Mask({WIDTH}, {HEIGHT});
                {script};
                return {result};
            }}""",
            argument,
        )

    yield run
    tab.close()


def pixels(values):
    return np.array(values, np.uint8).reshape(HEIGHT, WIDTH)


def distance_to_segment(x0, y0, x1, y1):
    along = np.array([x1 - x0, y1 - y0])
    length = along @ along
    share = ((X - x0) * along[0] + (Y - y0) * along[1]) / length if length else 0 * X
    share = np.clip(share, 0, 1)
    return np.hypot(X - x0 - share * along[0], Y - y0 - share * along[1])


def test_a_stroke_is_all_within_its_radius(shape):
    rng = np.random.default_rng(1)
    for _ in range(40):
        x0, x1 = rng.uniform(-10, WIDTH + 10, 2)
        y0, y1 = rng.uniform(-10, HEIGHT + 10, 2)
        if rng.random() < 0.3:
            x1, y1 = x0, y0
        radius = rng.uniform(0.5, 20)
        drawn = pixels(shape("mask.stroke(...a, 255)", [x0, y0, x1, y1, radius]))
        distance = distance_to_segment(x0, y0, x1, y1)
        clear = abs(distance - radius) > EDGE
        np.testing.assert_array_equal(drawn[clear], np.where(distance < radius, 255, 0)[clear])


def test_the_smallest_brush_is_one_pixel(shape):
    drawn = pixels(shape("mask.stroke(10.5, 20.5, 10.5, 20.5, 0.5, 255)"))
    assert drawn[20, 10] == 255
    assert drawn.sum() == 255


def test_a_polygon_is_even_odd_even_where_it_crosses_itself(shape):
    rng = np.random.default_rng(2)
    for count in (3, 4, 7, 12):
        corners = rng.uniform(-8, 68, (count, 2))
        drawn = pixels(shape("mask.polygon(a, 255)", corners.tolist()))
        inside, clear = np.zeros(X.shape, bool), np.ones(X.shape, bool)
        for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, 0), strict=True):
            meets = (ay <= Y) != (by <= Y)
            at = ax + (Y - ay) / (by - ay) * (bx - ax)
            inside ^= meets & (at > X)
            clear &= ~meets | (abs(at - X) > EDGE)
        np.testing.assert_array_equal(drawn[clear], np.where(inside, 255, 0)[clear])


def test_a_pasted_rectangle_changes_nothing_else(shape):
    found = np.random.default_rng(3).integers(0, 2, (9, 14), np.uint8) * 255
    drawn = pixels(shape("mask.fill(255); mask.paste([5, 7, 19, 16], Uint8Array.from(a))",
                         found.ravel().tolist()))  # fmt: skip
    expected = np.full((HEIGHT, WIDTH), 255, np.uint8)
    expected[7:16, 5:19] = found
    np.testing.assert_array_equal(drawn, expected)


_CHANGES = """
    const random = (seed) => () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    const next = random(a);
    const past = new History();
    const states = [mask.data.slice()];
    const kinds = [
        () => mask.stroke(next() * 60, next() * 46, next() * 60, next() * 46, next() * 12, 255),
        () => mask.stroke(next() * 60, next() * 46, next() * 60, next() * 46, next() * 12, 0),
        () => mask.polygon([1, 2, 3, 4].map(() => [next() * 60, next() * 46]), 255),
        () => mask.invert(),
        () => mask.fill(next() < 0.5 ? 255 : 0),
    ];
    for (let k = 0; k < 30; k++) {
        kinds[Math.floor(next() * kinds.length)]();
        const change = mask.settle();
        if (!change) continue;
        past.push(change);
        states.push(mask.data.slice());
    }
    const equal = (x, y) => x.every((value, index) => value === y[index]);
    const wrong = [];
    for (let k = states.length - 2; k >= 0; k--) {
        past.undo(mask);
        if (!equal(mask.data, states[k])) wrong.push(["undo", k]);
    }
    if (past.undo(mask)) wrong.push("undone too far");
    for (let k = 1; k < states.length; k++) {
        past.redo(mask);
        const whole = equal(mask.data, states[k]) && equal(mask.settled, states[k]);
        if (!whole) wrong.push(["redo", k]);
    }
    if (past.redo(mask)) wrong.push("redone too far");
"""


@pytest.mark.parametrize("seed", [3, 14, 159])
def test_every_change_is_undone_and_redone_exactly(shape, seed):
    assert shape(_CHANGES, seed, "[states.length > 15, wrong]") == [True, []]


def test_what_changes_nothing_is_no_change(shape):
    script = "mask.stroke(9, 9, 9, 9, 5, 0); const first = mask.settle(); mask.fill(0)"
    assert shape(script, result="[first, mask.settle()]") == [None, None]


def test_a_change_given_up_leaves_no_trace(shape):
    drawn = shape("mask.stroke(30, 20, 40, 30, 6, 255); mask.settle();"
                  "mask.stroke(5, 5, 50, 40, 9, 255); mask.revert()")  # fmt: skip
    np.testing.assert_array_equal(
        pixels(drawn), np.where(distance_to_segment(30, 20, 40, 30) < 6, 255, 0)
    )


def test_masks_travel_unchanged(shape):
    script = "mask.polygon([[3, 4], [50, 9], [20, 44]], 255); const bytes = await packed(mask.data)"
    sent, came = shape(script, result="[[...mask.data], [...await unpacked(bytes)]]")
    assert sent == came
    assert sum(sent) > 0
