"""The forest against scikit-learn's own, across processes, and the cut against all labellings."""

from itertools import product

import cv2
import numpy as np
import pytest
from sklearn.ensemble import ExtraTreesClassifier

from tests.masking.scenes import photograph
from workbench.errors import InputError
from workbench.masking import forest as module
from workbench.masking.classifier import PAPER, Classifier, ClassifierOptions, trained
from workbench.masking.energy import _edge_weights, cut_by_evidence
from workbench.masking.features import pixel_features
from workbench.masking.histograms import Example, learned_from_clutter


def test_the_tables_say_what_scikit_learns_trees_say():
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(400, 5)).astype(np.float32)
    labels = samples[:, 0] * samples[:, 1] + 0.3 * rng.normal(size=400) > 0
    model = ExtraTreesClassifier(7, min_samples_leaf=3, random_state=1).fit(samples, labels)
    tables = module._tables([tree.tree_ for tree in model.estimators_])
    asked = rng.normal(size=(300, 5)).astype(np.float32)
    found = module.mean_leaf_values(
        asked, tables.roots, tables.feature, tables.threshold, tables.children, tables.value
    )
    assert found == pytest.approx(model.predict_proba(asked)[:, 1], abs=1e-6)


@pytest.fixture(scope="module")
def example() -> Example:
    return Example(*photograph(1))


@pytest.mark.parametrize(
    "options", [ClassifierOptions(trees=8), ClassifierOptions(trees=0), PAPER], ids=str
)
def test_a_classifier_comes_back_from_its_arrays_and_says_the_same(example, options, tmp_path):
    image, _ = photograph(5, centre=(0.4, 0.6))
    made = trained([example], options)
    np.savez(tmp_path / "made.npz", **made.arrays())
    with np.load(tmp_path / "made.npz") as stored:
        again = Classifier.from_arrays(dict(stored))
    assert np.array_equal(again.probability(image), made.probability(image), equal_nan=True)
    assert again.options == options


def test_marked_clutter_alone_grows_no_forest(example):
    made = trained([example], ClassifierOptions(), learned_from_clutter)
    again = Classifier.from_arrays(made.arrays())
    assert again.forest is None
    assert again.appearance.foreground is None


def test_the_same_examples_give_the_same_forest(example):
    first, second = (module.grown([example], 4) for _ in range(2))
    for name, table in first.arrays().items():
        assert np.array_equal(table, second.arrays()[name])


def test_a_forest_finds_the_disc_and_knows_less_of_dark_photographs_but_the_same(example):
    forest = module.grown([example], 12)
    image, truth = photograph(9, centre=(0.45, 0.55))
    # Half the light: the flash stood further off.
    darker = np.asarray(255 * (image / 255.0) * 0.8, np.uint8)
    for shown in (image, darker):
        wrong = (forest.probability(shown) > 0.5) != (truth > 127)
        assert wrong.mean() < 0.03


def stripes(scale: float) -> Example:
    """A square of fine stripes on coarse ones, all grey and equally bright."""
    y, x = np.mgrid[:240, :240]
    inside = (abs(x - 120) < 70) & (abs(y - 120) < 70)
    period = scale * np.where(inside, 16.0, 48.0)
    noise = np.random.default_rng(0).normal(0, 6, x.shape)
    grey = np.clip(120 + 60.0 * np.sin(2 * np.pi * (x + y) / period) + noise, 0, 255)
    return Example(
        np.dstack([grey.astype(np.uint8)] * 3), np.where(inside, 255, 0).astype(np.uint8)
    )


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_what_stands_nearer_or_further_off_is_known_again(scale, monkeypatch):
    seen, shown = stripes(1.0), stripes(scale)

    def wrong() -> float:
        found = module.grown([seen], 12).probability(np.asarray(shown.image, np.uint8))
        return float(((found > 0.5) != shown.foreground).mean())

    at_all_sizes = wrong()
    monkeypatch.setattr(module, "_SCALES", (1.0,))
    assert at_all_sizes < 0.5 * wrong()


def test_both_classes_must_be_shown(example):
    nothing = Example(example.image, np.zeros_like(example.mask))
    with pytest.raises(InputError, match="both"):
        module.grown([nothing], 3)


def test_features_do_not_depend_on_where_in_the_image_a_pixel_is():
    flat = np.full((60, 80, 3), (120, 80, 60), np.uint8)
    features = pixel_features(flat)
    assert features.dtype == np.float32
    assert np.abs(features - features[30, 40]).max() < 1e-2


def test_the_cut_has_the_least_energy_of_all_labellings():
    rng = np.random.default_rng(4)
    for _ in range(5):
        image = rng.integers(0, 255, (3, 4, 3), dtype=np.uint8)
        evidence = rng.normal(0, 2, (3, 4)).astype(np.float32)
        lab = cv2.cvtColor(image.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
        weights = _edge_weights(np.asarray(lab, np.float32), 2.0)

        def energy(labels, weights=weights, evidence=evidence):
            data = np.where(labels, np.maximum(-evidence, 0), np.maximum(evidence, 0)).sum()
            total = float(data)
            for (down, right), weight in zip(((0, 1), (1, 0), (1, 1), (1, -1)), weights,
                                             strict=True):  # fmt: skip
                for y, x in product(range(3), range(4)):
                    if 0 <= y + down < 3 and 0 <= x + right < 4:
                        total += weight[y, x] * (labels[y, x] != labels[y + down, x + right])
            return total

        found = cut_by_evidence(image, evidence, 2.0)
        least = min(
            energy(np.array(bits, bool).reshape(3, 4)) for bits in product((0, 1), repeat=12)
        )
        assert energy(found) == pytest.approx(least, abs=1e-6)


def test_without_smoothness_evidence_alone_decides():
    image, _ = photograph(2, 40)
    evidence = np.random.default_rng(1).normal(size=(40, 40)).astype(np.float32)
    assert np.array_equal(cut_by_evidence(image, evidence, 0.0), evidence > 0)
