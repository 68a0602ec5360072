"""Which window should refine a board's corners? Boards drawn with a known camera, refined by OpenCV's cornerSubPix, the same scheme as
palpate's; what calibration makes of them against the truth.

Usage: board_windows.py [640|320]      (needs opencv-python-headless and numpy; minutes)

Fourteen random views, three times; whole boards, and boards whose outer squares are cut to half as OpenCV's sample board's are.
"""

import sys

import cv2
import numpy as np

WIDTH = int(sys.argv[1]) if len(sys.argv) > 1 else 640
SCALE, HEIGHT, RAYS, SQUARE = WIDTH / 640, WIDTH * 3 // 4, 4, 0.025
K = np.array([[533 * SCALE, 0, 341 * SCALE], [0, 533 * SCALE, 234 * SCALE], [0, 0, 1]])
LENS = np.array([-0.282, 0.044, 0.0011, -0.0003, 0.1266])
BOARD = np.zeros((54, 3), np.float32)
BOARD[:, :2] = SQUARE * np.mgrid[0:9, 0:6].T.reshape(-1, 2)
LOOKS = {"clear": (0.7, 2.0), "noisy": (0.9, 6.0), "blurred": (1.6, 3.0)}
RULES = {"5": 5, "7": 7, "9": 9, "11": 11, "0.30": 0.30, "0.35": 0.35, "0.40": 0.40, "0.45": 0.45}
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 0.001)

u, v = [(np.arange(n * RAYS) + 0.5) / RAYS - 0.5 for n in (WIDTH, HEIGHT)]
rays = cv2.undistortPoints(np.stack(np.meshgrid(u, v), -1).reshape(-1, 1, 2), K, LENS).reshape(HEIGHT * RAYS, WIDTH * RAYS, 2)


def project(pose):
    return cv2.projectPoints(BOARD, *pose, K, LENS)[0].reshape(-1, 2)


def spacing(corners):
    grid = corners.reshape(6, 9, 2)
    across, down = [np.linalg.norm(np.diff(grid, axis=a), axis=2) for a in (1, 0)]
    nearest = np.full((6, 9), np.inf)
    for part, gap in ((np.s_[:, 1:], across), (np.s_[:, :-1], across), (np.s_[1:], down), (np.s_[:-1], down)):
        nearest[part] = np.minimum(nearest[part], gap)
    return nearest.ravel()


def draw(pose, outer):
    rotation, _ = cv2.Rodrigues(pose[0])
    normal, offset = rotation[:, 2], pose[1]
    depth = normal @ offset / (rays @ normal[:2] + normal[2])
    points = np.concatenate([rays * depth[..., None], depth[..., None]], -1) - offset
    x, y = points @ rotation[:, 0] / SQUARE, points @ rotation[:, 1] / SQUARE
    # Beyond the first and the last column.
    sides = 1.0 if outer == 1.0 else outer
    inside = (x > -sides) & (x < 8 + sides) & (y > -1) & (y < 6)
    margin = 1.0 if outer == 1.0 else 0.05
    paper = (x > -sides - margin) & (x < 8 + sides + margin) & (y > -1 - margin) & (y < 6 + margin)
    dark = (np.floor(x) + np.floor(y)) % 2 == 0
    shade = np.where(inside & dark, 25.0, np.where(paper, 215.0, 90.0)).astype(np.float32)
    return shade.reshape(HEIGHT, RAYS, WIDTH, RAYS).mean((1, 3))


def poses(rng):
    while True:
        turn = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6), rng.choice([0.0, 1.5]) + rng.normal(0, 0.2)])
        pose = turn, np.array([rng.uniform(-0.2, 0.1), rng.uniform(-0.15, 0.1), rng.uniform(0.28, 0.5)])
        corners = project(pose)
        edge = 18 * SCALE
        if corners.min() > edge and (corners < [WIDTH - edge, HEIGHT - edge]).all() and spacing(corners).min() > 14 * SCALE:
            yield pose


def refine(image, rough, rule):
    windows = [rule] * len(rough) if isinstance(rule, int) else np.clip(rule * spacing(rough), 2, 10).astype(int)
    one = lambda p, w: cv2.cornerSubPix(image, p.reshape(1, 1, 2).astype(np.float32), (int(w), int(w)), (-1, -1), CRITERIA)
    return np.array([one(p, w).reshape(2) for p, w in zip(rough, windows)])


results = {}
for seed in range(3):
    rng = np.random.default_rng(seed)
    chosen = [pose for pose, _ in zip(poses(rng), range(14))]
    truth = [project(pose) for pose in chosen]
    for kind, outer in (("whole", 1.0), ("cut", 0.55)):
        sharp = [draw(pose, outer) for pose in chosen]
        for look, (blur, noise) in LOOKS.items():
            images = [cv2.GaussianBlur(i, (0, 0), blur) + rng.normal(0, noise, i.shape) for i in sharp]
            images = [np.clip(np.round(i), 0, 255).astype(np.uint8) for i in images]
            rough = [t + rng.normal(0, 0.6, t.shape) for t in truth]
            for name, rule in RULES.items():
                found = [refine(*pair, rule) for pair in zip(images, rough)]
                off = np.concatenate([np.linalg.norm(a - b, axis=1) for a, b in zip(found, truth)])
                views = [f.reshape(-1, 1, 2).astype(np.float32) for f in found]
                _, camera, *_ = cv2.calibrateCamera([BOARD] * 14, views, (WIDTH, HEIGHT), None, None)
                row = np.sqrt((off**2).mean()), 100 * abs(camera[0, 0] / K[0, 0] - 1)
                results.setdefault((kind, look, name), []).append(row)
print("board look     window   corners rms px   fx off %")
for (kind, look, name), rows in results.items():
    print(f"{kind:5} {look:8} {name:6}   {np.mean(rows, 0)[0]:.3f}            {np.mean(rows, 0)[1]:.3f} (worst {np.max(rows, 0)[1]:.3f})")
