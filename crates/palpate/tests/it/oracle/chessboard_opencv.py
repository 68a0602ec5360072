"""What OpenCV makes of its sample images left01 to left14: corners, camera, error. Writes chessboard_opencv.json.

Usage: chessboard_opencv.py FOLDER   (needs opencv-python-headless and numpy)
"""

import json
import pathlib
import sys

import cv2
import numpy as np

SIZE, SQUARE = (9, 6), 0.025
folder = pathlib.Path(sys.argv[1])
board = np.zeros((SIZE[0] * SIZE[1], 3), np.float32)
board[:, :2] = SQUARE * np.mgrid[0 : SIZE[0], 0 : SIZE[1]].T.reshape(-1, 2)
criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
out = {"opencv": cv2.__version__, "windows": {}}
# OpenCV's own samples refine in windows of 5 (calibrate.py) and of 11 (calibration.cpp) pixels to each side.
for window in (5, 11):
    corners = {}
    for path in sorted(folder.glob("left*.jpg")):
        gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found, rough = cv2.findChessboardCorners(gray, SIZE)
        assert found, path
        corners[path.name] = cv2.cornerSubPix(gray, rough, (window, window), (-1, -1), criteria).reshape(-1, 2)
    views = [c.reshape(-1, 1, 2).astype(np.float32) for c in corners.values()]
    rms, K, dist, _, _ = cv2.calibrateCamera([board] * len(views), views, gray.shape[::-1], None, None)
    out["windows"][window] = {
        "rms": rms,
        "K": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        "distortion": dist.ravel()[:5].tolist(),
        "corners": {name: [[round(float(v), 3) for v in p] for p in c] for name, c in corners.items()},
    }
    print(window, rms, out["windows"][window]["K"])
target = pathlib.Path(__file__).with_name("chessboard_opencv.json")
target.write_text(json.dumps(out) + "\n")
