"""What the paper reports of its own models, to stand beside a user's (Jaspe 2018, ch. 5)."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.voxels.dag_encoding import Encoding

_MEBIBYTE_BITS = 8 * 2**20
PUBLISHED_LEVELS = (11, 12, 13, 14, 15, 16)


@dataclass(frozen=True)
class PublishedModel:
    """One scanned statue of the tables; the paper's megabytes are 2²⁰ bytes.

    Attributes
    ----------
    name : of the model.
    million_voxels : table 5.1, at 2048³ and each doubling up to 65536³.
    mebibytes : table 5.4, by encoding, at the same resolutions.
    """

    name: str
    million_voxels: tuple[int, ...]
    mebibytes: dict[Encoding, tuple[float, ...]]

    def bits_per_voxel(self, encoding: Encoding, level: int) -> float | None:
        """What an encoding took at 2^level voxels a side; None where the paper does not tell."""
        if level not in PUBLISHED_LEVELS:
            return None
        place = PUBLISHED_LEVELS.index(level)
        if encoding not in self.mebibytes:
            return None
        bits = self.mebibytes[encoding][place] * _MEBIBYTE_BITS
        return bits / (1e6 * self.million_voxels[place])


PUBLISHED = (
    PublishedModel(
        "Lucy",
        (6, 25, 99, 395, 1580, 6321),
        {
            "svo": (2.0, 7.8, 31.3, 125.5, 502.2, 2009.2),
            "svdag": (4.0, 11.3, 36.8, 127.3, 419.0, 1212.0),
            "ussvdag": (2.9, 9.2, 32.3, 110.3, 332.4, 915.5),
            "esvdag": (2.1, 6.8, 24.0, 86.5, 295.1, 896.5),
            "ssvdag": (1.5, 5.3, 19.1, 67.2, 213.6, 642.2),
        },
    ),
    PublishedModel(
        "David",
        (4, 16, 64, 257, 1029, 4116),
        {
            "svo": (1.3, 5.1, 20.5, 81.9, 327.3, 1308.8),
            "svdag": (3.0, 8.8, 27.3, 91.8, 308.0, 938.6),
            "ussvdag": (2.2, 7.0, 23.3, 79.7, 252.7, 716.1),
            "esvdag": (1.5, 5.0, 17.1, 61.3, 214.3, 683.3),
            "ssvdag": (1.1, 3.9, 13.6, 48.1, 159.2, 486.7),
        },
    ),
)
