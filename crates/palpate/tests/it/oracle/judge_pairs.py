#!/usr/bin/env python3
"""Makes judge_pairs.json: ten closed mesh pairs judged by an independent implementation (Open3D's ray-casting scene, trimesh).

    pip install open3d trimesh numpy
    python3 judge_pairs.py JUDGE.PY YCB_FOLDER > judge_pairs.json

A pair is (predicted object, truth object, scale, rotation vector in radians, translation in metres): the predicted mesh is the object's,
each vertex v moved to scale · R v + t, where v is relative to the centre of the predicted object's box and t starts at the centre of the
truth object's box. The numbers are means over three seeds of 100 000 samples, and their standard deviation.
"""
import importlib.util, json, sys
import numpy as np, open3d, trimesh

PAIRS = [
    ("006_mustard_bottle", "006_mustard_bottle", 1.00, [0.02, -0.01, 0.05], [0.002, -0.001, 0.0015]),
    ("006_mustard_bottle", "021_bleach_cleanser", 1.10, [0.0, 0.0, 0.4], [0.0, 0.0, -0.004]),
    ("035_power_drill", "035_power_drill", 1.03, [0.0, 0.03, 0.0], [0.001, 0.002, 0.003]),
    ("025_mug", "025_mug", 0.98, [0.0, 0.0, 0.08], [0.0005, 0.0, 0.0]),
    ("024_bowl", "024_bowl", 1.00, [0.01, 0.0, 0.0], [0.0, 0.0003, 0.0004]),
    ("003_cracker_box", "003_cracker_box", 1.01, [0.0, 0.0, 0.03], [0.004, 0.0, 0.0]),
    ("004_sugar_box", "003_cracker_box", 1.25, [0.0, 0.0, 0.1], [0.0, 0.0, 0.0]),
    ("011_banana", "011_banana", 1.05, [0.02, 0.02, 0.02], [0.001, 0.001, 0.001]),
    ("055_baseball", "056_tennis_ball", 1.00, [0.5, 0.5, 0.5], [0.003, 0.0, 0.002]),
    ("037_scissors", "037_scissors", 1.00, [0.0, 0.0, 0.01], [0.0005, -0.0005, 0.0005]),
]

def moved(path, truth, scale, rotation, translation):
    mesh = trimesh.load(path, force="mesh", process=False)
    angle = np.linalg.norm(rotation)
    r = trimesh.transformations.rotation_matrix(angle, rotation)[:3, :3] if angle else np.eye(3)
    v = np.asarray(mesh.vertices, float)
    v = scale * (v - (v.min(0) + v.max(0)) / 2) @ r.T + truth.bounds.mean(0) + translation
    return trimesh.Trimesh(v, np.asarray(mesh.faces), process=False)

spec = importlib.util.spec_from_file_location("judge", sys.argv[1])
judge = importlib.util.module_from_spec(spec)
spec.loader.exec_module(judge)
out = {"versions": {"open3d": open3d.__version__, "trimesh": trimesh.__version__, "numpy": np.__version__}, "pairs": []}
for a, b, scale, rotation, translation in PAIRS:
    truth = judge.load(f"{sys.argv[2]}/{b}.ply")
    predicted = moved(f"{sys.argv[2]}/{a}.ply", truth, scale, rotation, translation)
    runs = [judge.judge(predicted, truth, seed=10 * s) for s in range(3)]
    numbers = {k: float(np.mean([r[k] for r in runs])) for k in runs[0] if isinstance(runs[0][k], float)}
    spread = {k: float(np.std([r[k] for r in runs])) for k in numbers}
    out["pairs"].append({"predicted": a, "truth": b, "scale": scale, "rotation": rotation, "translation": translation,
                         "mean": numbers, "spread": spread})
    print(a, b, f"IoU {numbers['volumetric_iou']:.4f}", file=sys.stderr)
json.dump(out, sys.stdout, indent=1)
print()
