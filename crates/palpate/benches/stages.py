"""The peers' side of the example measure_stages: stages.py DEPTH.png MESH.ply. One thread, median CPU seconds of five; needs open3d, scipy, numpy, trimesh."""
import os, resource, sys

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
import numpy as np, open3d as o3d, scipy.fft, trimesh
from scipy.spatial import cKDTree


def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def measure(name, work, result=lambda _: ""):
    spent = []
    for _ in range(5):
        start = cpu()
        made = work()
        spent.append(cpu() - start)
    print(f"{name} | {sorted(spent)[2]:.4f} | {result(made)}", flush=True)
    return made


depth = o3d.io.read_image(sys.argv[1])
camera = o3d.camera.PinholeCameraIntrinsic(640, 480, 616.3653, 616.2029, 310.2588, 236.5998)
lift = lambda: o3d.geometry.PointCloud.create_from_depth_image(depth, camera, depth_scale=10000.0, depth_trunc=10.0)
cloud = measure("depth to cloud", lift, lambda c: f"{len(c.points)} points")
plane, on = measure("plane 5 mm", lambda: cloud.segment_plane(0.005, 3, 1000), lambda f: f"{len(f[1])} inliers")
off = cloud.select_by_index(on, invert=True)
kept = lambda r: f"{len(r[1])} kept"
measure("statistical outliers k 20, 2 sigma, full frame", lambda: cloud.remove_statistical_outlier(20, 2.0), kept)
measure("normals kNN 30, full frame", lambda: cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30)))
measure("voxel 3 mm", lambda: cloud.voxel_down_sample(0.003), lambda c: f"{len(c.points)} points")
measure("statistical outliers k 20, 2 sigma, off the plane", lambda: off.remove_statistical_outlier(20, 2.0), kept)
labels = measure("DBSCAN 10 mm, min 10, off the plane", lambda: np.asarray(off.cluster_dbscan(0.01, 10)))
sizes = np.bincount(labels[labels >= 0])
print(f"  {sizes.max()} of {len(labels)} points in the largest of {len(sizes)}")
thin = off.voxel_down_sample(0.003)
measure("DBSCAN 10 mm, min 5, off the plane on 3 mm voxels", lambda: np.asarray(thin.cluster_dbscan(0.01, 5)))

mesh = o3d.io.read_triangle_mesh(sys.argv[2])
vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def scene():
    made = o3d.t.geometry.RaycastingScene(nthreads=1)
    made.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    made.cast_rays(o3d.core.Tensor(np.array([[0, 0, 1, 0, 0, -1]], np.float32)), nthreads=1)
    return made


tree = measure("BVH build", scene, lambda _: f"{len(faces)} triangles")
middle = (vertices.min(0) + vertices.max(0)) / 2
u, v = np.meshgrid(np.arange(640) - 319.5, np.arange(480) - 239.5)
directions = np.stack([u, v, np.full_like(u, -600.0)], -1).reshape(-1, 3) / 600
rays = np.hstack([np.tile(middle + [0, 0, 0.4], (len(directions), 1)), directions]).astype(np.float32)
rays = o3d.core.Tensor(rays)
measure("cast 640x480", lambda: tree.cast_rays(rays, nthreads=1), lambda r: f"{int(np.isfinite(r['t_hit'].numpy()).sum())} hits")
queries = o3d.core.Tensor((middle + np.random.default_rng(0).uniform(-0.15, 0.15, (100_000, 3))).astype(np.float32))
measure("closest point, 100k in 300 mm", lambda: tree.compute_distance(queries, nthreads=1), lambda d: f"mean {1e3 * float(d.numpy().mean()):.3f} mm")
a, b = (trimesh.sample.sample_surface(trimesh.Trimesh(vertices, faces, process=False), 100_000, seed=s)[0] for s in (1, 2))
both = lambda p, q: (cKDTree(q).query(p)[0].mean() + cKDTree(p).query(q)[0].mean()) * 500
measure("chamfer 100k, near, SciPy", lambda: both(a, b), lambda c: f"{c:.3f} mm")
pair = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (a, b)]
measure("chamfer 100k, near, Open3D", lambda: (pair[0].compute_point_cloud_distance(pair[1]), pair[1].compute_point_cloud_distance(pair[0])))
measure("chamfer 100k, 20 mm apart, SciPy", lambda: both(a, b + [0.02, 0, 0]), lambda c: f"{c:.3f} mm")
divergence = np.random.default_rng(0).normal(size=(480, 640))
i, j = np.arange(1, 481)[:, None], np.arange(1, 641)[None]
scale = 2 * np.cos(np.pi * i / 481) + 2 * np.cos(np.pi * j / 641) - 4
measure("fast Poisson 640x480, DST-I", lambda: scipy.fft.idstn(scipy.fft.dstn(divergence, type=1) / scale, type=1))
