"""Reads the fields of motion off Taxim's published plots, square_compose.jpg and cylinder6_compose.jpg.

    python taxim_compose.py FOLDER > taxim_compose.json

Each plot shows the motion along x, y and z of a 480 x 640 image in matplotlib's RdBu, scaled to its own range. The colours are
turned back into 0 ... 255 and averaged to 30 x 40 cells. Written with Python 3.11, matplotlib 3.11, OpenCV 4.
"""

import json
import pathlib
import sys

import cv2
import matplotlib
import numpy as np

folder = pathlib.Path(sys.argv[1])
colors = matplotlib.colormaps["RdBu"](np.linspace(0, 1, 256))[:, :3] * 255
fields = {}
for name in ("square", "cylinder6"):
    image = cv2.imread(str(folder / f"{name}_compose.jpg"))[..., ::-1].astype(float)
    for axis, top in zip("xyz", (59, 189, 319)):
        panel = image[top : top + 107, 257:400]
        level = ((panel[..., None, :] - colors) ** 2).sum(-1).argmin(-1).astype(np.float32)
        cells = cv2.resize(level, (40, 30), interpolation=cv2.INTER_AREA)
        fields[f"{name}_{axis}"] = np.round(cells).astype(int).ravel().tolist()
print(json.dumps({"rows": 30, "cols": 40, "fields": fields}, separators=(",", ":")))
