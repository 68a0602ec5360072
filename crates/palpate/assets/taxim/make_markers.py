"""Reduces Taxim's two finite-element presses to four radial profiles, markers.bin (f32, little-endian).

    python make_markers.py FOLDER       # with 0705_dome_node_dz_0.3/ and 0705_dome_node_dxdz_0.3/

The text files (Taxim, MIT licence, see NOTICE.md) list the nodes of a dome's surface and how far each moves, metres, when the
node at the apex is pressed in by 0.3 mm (dz), and when it is pressed and dragged along x as well (dxdz). The dome is round and its
gel isotropic, so the answer to a pure load has one harmonic of the angle t around the apex only:

    pressed along z:  u_z = N(r)          u_r = R(r)          u_t = 0
    dragged along x:  u_r = A(r) cos t    u_t = -B(r) sin t

Splines for the harmonics 0 and 1 are fitted to dz and to dxdz - dz; the other harmonics (the press of dz leans by a fifth towards
+y; the drag of dxdz - dz also presses) are fitted beside and left out. N and R are divided by N(0), A and B by A(0) = B(0):
motion per unit motion of the loaded spot. The file: N, R, A, B, each at 0, 0.05 ... 16.8 mm. Written with Python 3.11, NumPy 2.4,
SciPy 1.17. Prints what the profiles leave unexplained.
"""

import pathlib
import sys

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import lsq_linear

STEP, COUNT = 0.05, 337  # mm
folder = pathlib.Path(sys.argv[1])


def motion(name):
    """Node positions around the apex, mm, and displacements, micrometres."""
    tables = [np.loadtxt(folder / f"0705_dome_node_{name}" / f"0705_dome_node_{name}_{a}.txt", skiprows=1) for a in "xyz"]
    position = tables[0][:, 1:4]
    apex = (position.min(0) + position.max(0)) / 2
    return (position - apex)[:, :2] * 1e3, np.stack([t[:, 4] for t in tables], 1) * 1e6


xy, press = motion("dz_0.3")
drag = motion("dxdz_0.3")[1] - press
r = np.hypot(*xy.T)
cos, sin = (xy / np.maximum(r, 1e-9)[:, None]).T

end = STEP * (COUNT - 1)
inner = np.r_[np.arange(0.1, 1.5, 0.1), np.geomspace(1.5, end, 20)[:-1]]
knots = np.r_[[0.0] * 4, inner, [end] * 4]
basis = lambda at, order=0: np.stack(
    [BSpline(knots, row, 3).derivative(order)(at) if order else BSpline(knots, row, 3)(at) for row in np.eye(len(knots) - 4)], 1
)
at_node = basis(np.clip(r, 0, end))
n = at_node.shape[1]
fine = np.linspace(0, end, 2000)
# Bending is dear where the profile is flat and cheap at the peak, whose width is that of a mesh cell.
stiff = basis(fine, 2) * (1e-3 * np.minimum(1, fine**2 + 0.05))[:, None]
radial = lambda u: u[:, 0] * cos + u[:, 1] * sin
tangential = lambda u: u[:, 1] * cos - u[:, 0] * sin
# Angle modulation of each harmonic.
modes = [np.ones_like(cos), cos, sin]


def falling(profiles, which):
    """Change of variables under which "falls up to 1 mm" is "the first variables are positive", and those variables."""
    change, positive = np.eye(profiles * n), np.zeros(profiles * n, bool)
    for p in which:
        k = np.searchsorted(knots, 1.0)
        # The first k coefficients are sums of falls, down to the one after them.
        block = change[p * n : (p + 1) * n, p * n : (p + 1) * n]
        block[:k, : k + 1] = np.triu(np.ones((k, k + 1)))
        positive[p * n : p * n + k] = True
    return change, positive


def fit(blocks, values, constraints, fall=()):
    """Least squares for several profiles at once: blocks of rows, each a list of (profile, modulation).

    Profiles in `fall` fall from the apex up to 1 mm: so near to it there are too few nodes to tell.
    """
    profiles = 1 + max(p for block in blocks for p, _ in block)
    rows, right = [], []
    for block, value in zip(blocks, values):
        a = np.zeros((len(r), profiles * n))
        for p, m in block:
            a[:, p * n : (p + 1) * n] += at_node * m[:, None]
        rows.append(a), right.append(value)
    for p in range(profiles):
        a = np.zeros((len(fine), profiles * n))
        a[:, p * n : (p + 1) * n] = stiff
        rows.append(a), right.append(np.zeros(len(fine)))
    for terms in constraints:
        a = np.zeros((1, profiles * n))
        for p, order, sign in terms:
            a[0, p * n : (p + 1) * n] += sign * 1e4 * basis(np.array([0.0]), order)[0]
        rows.append(a), right.append(np.zeros(1))
    # Every profile ends at zero, where the dome is clamped.
    for p in range(profiles):
        a = np.zeros((1, profiles * n))
        a[0, (p + 1) * n - 1] = 1e3
        rows.append(a), right.append(np.zeros(1))
    change, positive = falling(profiles, fall)
    q, upper = np.linalg.qr(np.vstack(rows) @ change)
    bounds = np.where(positive, 0, -np.inf), np.full(profiles * n, np.inf)
    solution = lsq_linear(upper, q.T @ np.concatenate(right), bounds, method="bvls" if fall else "trf", tol=1e-12).x
    solution = (change @ solution).reshape(profiles, n)
    residual = np.concatenate(values) - np.vstack(rows[: len(blocks)]) @ solution.ravel()
    return solution, residual.reshape(len(blocks), -1)


def report(name, value, residual):
    ring = (r > 0.5) & (r < 9)
    rms = lambda v: np.sqrt(np.mean(v**2))
    print(f"{name}: rms {rms(value[ring]):.3f}, unexplained {rms(residual[ring]):.3f} um at 0.5-9 mm; "
          f"nearer {rms(value[r < .5]):.1f}, {rms(residual[r < .5]):.1f} um")


# dz: profiles 0-2 are u_z with harmonics 1, cos, sin; 3-5 u_r.
z_modes = [(i, m) for i, m in enumerate(modes)]
(N, *_), e = fit([z_modes], [press[:, 2]], [[(0, 1, 1)], [(1, 0, 1)], [(2, 0, 1)]], [0])
report("press u_z", press[:, 2], e[0])
# A uniform shift at the apex is harmonic 1 of u_r and u_t together, so the two are fitted jointly (0 = R).
drift = [[(0, modes[0]), (1, cos), (2, sin)], [(3, -sin), (4, cos)]]
(R, *_), e = fit(drift, [radial(press), tangential(press)], [[(0, 0, 1)], [(1, 0, 1), (3, 0, -1)], [(2, 0, 1), (4, 0, -1)]])
report("press u_r", radial(press), e[0])
drift = [[(0, cos), (1, modes[0]), (2, sin)], [(3, -sin), (4, cos)]]
(A, _, _, B, _), e = fit(drift, [radial(drag), tangential(drag)],
                         [[(0, 0, 1), (3, 0, -1)], [(0, 1, 1)], [(3, 1, 1)], [(1, 0, 1)], [(2, 0, 1), (4, 0, -1)]], [0, 3])
report("drag u_r", radial(drag), e[0])
report("drag u_t", tangential(drag), e[1])

at = basis(np.arange(COUNT) * STEP)
N, R, A, B = (at @ p for p in (N, R, A, B))
print("at the apex: u_z %.1f um of the press, u_x %.1f um of the drag" % (N[0], A[0]))
packed = np.stack([N / N[0], R / N[0], A / A[0], B / A[0]]).astype("<f4")
packed[:, -1] = 0
packed[1, 0] = 0
packed[3, 0] = packed[2, 0]
for name, row in zip("NRAB", packed):
    print(name, np.round(row[[0, 2, 4, 6, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320]], 4))
target = pathlib.Path(__file__).with_name("markers.bin")
target.write_bytes(packed.tobytes())
print(target.name, target.stat().st_size, "bytes")
