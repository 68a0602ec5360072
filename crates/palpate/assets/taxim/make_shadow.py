"""Packs Taxim's shadow table into shadow.bin, little-endian, after checking that nothing is lost that matters.

    python make_shadow.py FOLDER        # with shadowDirections.npy, shadowTable_lengths.npy, shadowTable_flat.npy

The three arrays are the contents of Taxim's shadowTable.npz (MIT licence, see NOTICE.md): 63 directions, the lengths of the lists
per channel (B, G, R), direction and depth, and the lists one after another in that order. The file is the 3 x 63 x 9 lengths as
u8, then the values times 256, rounded, as i16: colour changes in grey levels to within 0.002. Directions are 0.1 rad apart and so
are not stored. Written with Python 3.11 and NumPy 2.4.
"""

import pathlib
import sys

import numpy as np

folder = pathlib.Path(sys.argv[1])
directions = np.load(folder / "shadowDirections.npy")
lengths = np.load(folder / "shadowTable_lengths.npy")
flat = np.load(folder / "shadowTable_flat.npy")

assert np.allclose(directions, 0.1 * np.arange(63), atol=1e-12)
assert lengths.shape == (3, 63, 9) and lengths.max() < 256 and lengths.sum() == len(flat)
packed = np.round(flat * 256)
assert np.abs(packed).max() < 2**15 and np.abs(packed / 256 - flat).max() <= 1 / 512

target = pathlib.Path(__file__).with_name("shadow.bin")
target.write_bytes(lengths.astype("u1").tobytes() + packed.astype("<i2").tobytes())
print(target.name, target.stat().st_size, "bytes")
