"""Run by peers.sh: TRUTH SCRATCH MEASURE. Each method in its own process; one thread; CPU inside the call; exact point-to-triangle error."""
import json, os, platform, subprocess, sys, time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"


def memory(name):
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024


def peer(cloud, method, out, values):
    """One peer in this process; prints what measure_surface prints."""
    import numpy as np, resource

    def cpu():
        used = resource.getrusage(resource.RUSAGE_SELF)
        return used.ru_utime + used.ru_stime

    if method.startswith("o3d"):
        import open3d as o3d
        points = o3d.io.read_point_cloud(cloud)
        before, start, clock = memory("VmRSS"), cpu(), time.perf_counter()
        if method == "o3d-poisson":
            mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(points, depth=int(values[0]), linear_fit=True, n_threads=1)
        else:
            mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(points, o3d.utility.DoubleVector(values))
        spent, wall, peak = cpu() - start, time.perf_counter() - clock, memory("VmHWM")
        o3d.io.write_triangle_mesh(out, mesh)
        faces = np.asarray(mesh.triangles)
    else:
        import pymeshlab
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(cloud)
        before, start, clock = memory("VmRSS"), cpu(), time.perf_counter()
        meshes.generate_surface_reconstruction_screened_poisson(depth=int(values[0]), threads=1)
        spent, wall, peak = cpu() - start, time.perf_counter() - clock, memory("VmHWM")
        meshes.save_current_mesh(out)
        faces = meshes.current_mesh().face_matrix()
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    print(json.dumps({"cpu_s": [spent], "wall_s": [wall], "peak_mb": peak, "before_mb": before, "triangles": len(faces),
                      "open_edges": int((counts == 1).sum()), "many": int((counts > 2).sum())}))


if sys.argv[1] == "--peer":
    peer(sys.argv[2], sys.argv[3], sys.argv[4], [float(v) for v in sys.argv[5:]])
    sys.exit()

import numpy as np, open3d as o3d, trimesh

truth_path, scratch, measure = sys.argv[1:4]


def load(path):
    mesh = o3d.io.read_triangle_mesh(path)
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles), process=False)


def distance(a, b, seed):
    samples = trimesh.sample.sample_surface(a, 100_000, seed=seed)[0].astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(np.asarray(b.vertices, np.float32)), o3d.core.Tensor(np.asarray(b.faces, np.uint32)))
    near = scene.compute_closest_points(o3d.core.Tensor(samples), nthreads=1)["points"].numpy()
    return 1e3 * float(np.linalg.norm(near - samples, axis=1).mean())


truth = load(truth_path)


def cloud(count):
    path = f"{scratch}/{count}.ply"
    if not os.path.exists(path):
        points, faces = trimesh.sample.sample_surface(truth, count, seed=0)
        points = points + np.random.default_rng(0).normal(0, 3e-4, points.shape)
        rows = np.hstack([points, truth.face_normals[faces]]).astype("<f4")
        names = "".join(f"property float {n}\n" for n in ("x", "y", "z", "nx", "ny", "nz"))
        with open(path, "wb") as file:
            file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{names}end_header\n".encode())
            file.write(rows.tobytes())
    return path


def run(who, path, method, values, threads=1):
    out = f"{scratch}/{who}.ply"
    if who == "palpate":
        flag = {"poisson": "--depth", "ball-pivoting": "--radius", "implicit": "--cell"}[method]
        command = [measure, path, method, "--out", out, "--threads", str(threads)] + [w for v in values for w in (flag, str(v))]
    else:
        command = [sys.executable, __file__, "--peer", path, method, out] + [str(v) for v in values]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(f"{command}: {result.stderr}")
    return json.loads(result.stdout.strip().splitlines()[-1])


def row(label, who, runs):
    last = runs[-1]
    mesh = load(f"{scratch}/{who}.ply")
    forth, back = distance(mesh, truth, 0), distance(truth, mesh, 1)
    many = last.get("many", 0 if last.get("edge_manifold") else "?")
    cpu, wall = (float(np.median([r[k][0] for r in runs])) for k in ("cpu_s", "wall_s"))
    print(f"| {label} | {who} | {cpu:.2f} | {wall:.2f} | {last['peak_mb']:.0f} ({last['before_mb']:.0f}) | {last['triangles']:,} "
          f"| {forth:.4f} | {back:.4f} | {last['open_edges']} | {many} |", flush=True)


def compare(label, path, repeats, jobs):
    runs = {who: [] for who, _, _ in jobs}
    for _ in range(repeats):
        for who, method, values in jobs:
            runs[who].append(run(who, path, method, values))
    for who, _, _ in jobs:
        row(label, who, runs[who])


def two_threads(label, path, repeats, method, values):
    """Wall seconds of one and two threads of ours, alternating."""
    walls = {n: [] for n in (1, 2)}
    for _ in range(repeats):
        for n in walls:
            walls[n].append(run("palpate", path, method, values, threads=n)["wall_s"][0])
    one, two = (float(np.median(w)) for w in walls.values())
    speed_ups.append(f"| {label} | {one:.2f} | {two:.2f} | {one / two:.2f} |")


speed_ups = []
few, some, many = (int(r) for r in os.environ.get("REPEATS", "5 3 1").split())
points = [int(p) for p in os.environ.get("POINTS", "10000 50000 200000 1000000").split()]
repeats = lambda count: few if count <= 50_000 else some if count <= 200_000 else many
depths = {10_000: [7, 8], 50_000: [7, 8, 9, 10], 200_000: [7, 8, 9, 10], 1_000_000: [7, 8, 9, 10]}
processor = next((l.split(":")[1].strip() for l in open("/proc/cpuinfo") if l.startswith("model name")), platform.machine())
import importlib.metadata as versions
print(f"{processor}, {os.cpu_count()} cores, one thread each; Open3D {versions.version('open3d')}, PyMeshLab {versions.version('pymeshlab')}, "
      f"NumPy {np.__version__}; {time.strftime('%Y-%m-%d')}\n")
print("| cloud | who | CPU s | wall s | peak MB (before) | triangles | err→ mm | err← mm | open edges | edges of > 2 faces |\n|---|---|---|---|---|---|---|---|---|---|")
for count in points:
    path = cloud(count)
    for depth in depths.get(count, [7, 8]):
        jobs = [("palpate", "poisson", [depth]), ("open3d", "o3d-poisson", [depth])]
        if (count, depth) in ((10_000, 7), (50_000, 8), (200_000, 9)):
            jobs.append(("pymeshlab", "pml-poisson", [depth]))
        compare(f"Poisson {count // 1000}k d{depth}", path, repeats(count), jobs)
    compare(f"Poisson {count // 1000}k automatic", path, repeats(count), [("palpate", "poisson", [])])
    spacing = float(np.sqrt(truth.area / count))
    radii = [spacing, 2 * spacing, 4 * spacing]
    compare(f"balls {count // 1000}k", path, repeats(count), [("palpate", "ball-pivoting", radii), ("open3d", "o3d-balls", radii)])
    compare(f"implicit {count // 1000}k", path, repeats(count), [("palpate", "implicit", [])])
    if count in (50_000, 200_000):
        two_threads(f"Poisson {count // 1000}k automatic", path, repeats(count), "poisson", [])
        two_threads(f"implicit {count // 1000}k", path, repeats(count), "implicit", [])
for cells in (128, 256):
    size = float(truth.extents.max()) / cells
    compare(f"implicit 50k, {cells} cells", cloud(50_000), few, [("palpate", "implicit", [size])])
    two_threads(f"implicit 50k, {cells} cells", cloud(50_000), few, "implicit", [size])
print("\n| ours | wall s, one thread | two | speed-up |\n|---|---|---|---|", *speed_ups, f"\nLoad averages at the end: {os.getloadavg()}", sep="\n")
