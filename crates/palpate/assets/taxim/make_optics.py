#!/usr/bin/env python3
"""Makes the optical assets of this folder from Taxim's calibration files (MIT licence; Si & Yuan, RA-L 2022).

    python make_optics.py TAXIM_DATA

TAXIM_DATA holds polycalib_<sensor>_grad_rgb.npy, float64 [3 (B, G, R), bins, bins, 6], and golden/{square,cylinder6}_height.npy
with their _sim.jpg. Needs numpy and opencv-python.

- <sensor>.npy: the same coefficients as float16, reordered to [magnitude, direction, channel R G B, term]. Terms multiply
  x^2 y^2 xy x y 1 with x, y in units of the frame's WIDTH, so that float16 holds all of them: the images differ by < 0.1 level.
- background.jpg: the two golden images minus their rendered colour change, averaged; a 7 px median removes the JPEG traces of
  the two presses. No photograph was used.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

source, target = Path(sys.argv[1]), Path(__file__).parent
WIDTHS = {"default_gelsight": 640, "gelsight_r1.5": 480, "digit": 640}
for name, width in WIDTHS.items():
    table = np.load(source / f"polycalib_{name}_grad_rgb.npy")[::-1].transpose(1, 2, 0, 3)
    scaled = table * np.array([width**2, width**2, width**2, width, width, 1.0])
    np.save(target / f"{name}.npy", np.ascontiguousarray(scaled).astype("<f2"))

rows, cols = np.mgrid[0:480, 0:640].astype(float)
terms = np.stack([cols**2, rows**2, cols * rows, cols, rows, np.ones_like(rows)], -1)
table = np.load(source / "polycalib_default_gelsight_grad_rgb.npy")


def change(height):
    """Taxim's colour change (B, G, R) of a height map in pixels."""
    by_row, by_col = np.zeros_like(height), np.zeros_like(height)
    by_row[1:-1] = (height[2:] - height[:-2]) / 2
    by_col[:, 1:-1] = (height[:, 2:] - height[:, :-2]) / 2
    slope = np.hypot(by_row, by_col)
    magnitude = np.pad(np.arctan(slope)[1:-1, 1:-1], 1, "symmetric")
    direction = np.where(slope > 0, np.arctan2(by_row, by_col), 0)
    direction = np.pad(direction[1:-1, 1:-1], 1, "symmetric")
    i = np.floor(magnitude / (0.5 * np.pi / 124)).astype(int)
    j = np.floor((direction + np.pi) / (2 * np.pi / 124)).astype(int)
    return np.stack([(terms * table[k, i, j]).sum(-1) for k in range(3)], -1)


golden = source / "golden"
frames = [
    cv2.imread(str(golden / f"{name}_sim.jpg")) - change(np.load(golden / f"{name}_height.npy").astype(float))
    for name in ("square", "cylinder6")
]
mean = np.clip(np.round(np.mean(frames, 0)), 0, 255).astype(np.uint8)
smooth = np.stack([cv2.medianBlur(np.ascontiguousarray(mean[..., k]), 7) for k in range(3)], -1)
cv2.imwrite(str(target / "background.jpg"), smooth, [cv2.IMWRITE_JPEG_QUALITY, 95])
