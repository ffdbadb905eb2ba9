"""Our pose-graph solver against GTSAM (through its Python binding) on the same graph.

    pip install gtsam numpy scipy
    python3 verify.py OPTIMISE_BINARY graph.g2o

The poses of the given graph are disturbed by seeded noise; both solvers then minimise the same plain
least squares from there. Compared are the costs of both solutions and the largest difference of a pose,
computed by the code below alone.
"""
import subprocess, sys, tempfile, os
import numpy as np
import gtsam


def parse(path):
    vertices, edges, fixed = {}, [], []
    for line in open(path):
        f = line.split()
        if not f or f[0].startswith("#"):
            continue
        if f[0] == "VERTEX_SIM3:QUAT":
            vertices[int(f[1])] = np.array(f[2:10], float)
        elif f[0] == "EDGE_SIM3:QUAT":
            v = np.array(f[3:], float)
            w = np.zeros((7, 7))
            w[np.triu_indices(7)] = v[8:]
            edges.append((int(f[1]), int(f[2]), v[:8], w + np.triu(w, 1).T))
        elif f[0] == "FIX":
            fixed.append(int(f[1]))
    return vertices, edges, fixed


def write(path, vertices, edges, fixed):
    with open(path, "w") as out:
        for k, v in vertices.items():
            out.write(f"VERTEX_SIM3:QUAT {k} " + " ".join(map(repr, map(float, v))) + "\n")
        for k in fixed:
            out.write(f"FIX {k}\n")
        for i, j, m, w in edges:
            upper = w[np.triu_indices(7)]
            numbers = " ".join(repr(float(x)) for x in np.concatenate([m, upper]))
            out.write(f"EDGE_SIM3:QUAT {i} {j} {numbers}\n")


def matrix(v):
    x, y, z, w = v[3:7] / np.linalg.norm(v[3:7])
    r = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = v[7] * r, v[:3]
    return m


def log(m):
    """Tangent [v, w, s] of a 4x4 similarity, by the logarithm of matrices."""
    from scipy.linalg import logm
    l = np.real(logm(m))
    s = np.trace(l[:3, :3]) / 3
    a = l[:3, :3]
    return np.array([*l[:3, 3], a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1], 2 * s]) * [1, 1, 1, .5, .5, .5, .5]


def cost(t, edges):
    total = 0.0
    for i, j, m, w in edges:
        r = log(np.linalg.inv(t[i]) @ t[j] @ np.linalg.inv(matrix(m)))
        total += 0.5 * r @ w @ r
    return total


def similarity(m):
    """GTSAM's similarity maps p to s (R p + t)."""
    s = np.cbrt(np.linalg.det(m[:3, :3]))
    return gtsam.Similarity3(gtsam.Rot3(m[:3, :3] / s), m[:3, 3] / s, s)


def plain(similarity):
    m = np.eye(4)
    m[:3, :3] = similarity.scale() * similarity.rotation().matrix()
    m[:3, 3] = similarity.scale() * similarity.translation()
    return m


def exp(tangent):
    from scipy.linalg import expm
    v, w, s = tangent[:3], tangent[3:6], tangent[6]
    l = np.zeros((4, 4))
    l[:3, :3] = [[s, -w[2], w[1]], [w[2], s, -w[0]], [-w[1], w[0], s]]
    l[:3, 3] = v
    return expm(l)


def information_of(m, w):
    """Of GTSAM's residual Log(M^-1 T_ij), which depends linearly on ours: by numeric differentiation."""
    inverse, h = np.linalg.inv(m), 1e-6
    residual = lambda d: gtsam.Similarity3.Logmap(similarity(inverse @ exp(d) @ m))
    columns = [(residual(h * e) - residual(-h * e)) / (2 * h) for e in np.eye(7)]
    back = np.linalg.inv(np.array(columns).T)
    full = back.T @ w @ back
    return (full + full.T) / 2


def by_gtsam(vertices, edges, fixed):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, v in vertices.items():
        values.insert(k, similarity(matrix(v)))
        if k in fixed:
            graph.add(gtsam.NonlinearEqualitySimilarity3(k, similarity(matrix(v))))
    for i, j, v, w in edges:
        m = matrix(v)
        noise = gtsam.noiseModel.Gaussian.Information(information_of(m, w))
        graph.add(gtsam.BetweenFactorSimilarity3(i, j, similarity(m), noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-12)
    parameters.setMaxIterations(500)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return {k: plain(result.atSimilarity3(k)) for k in vertices}


def main():
    binary, path = sys.argv[1:3]
    vertices, edges, fixed = parse(path)
    random = np.random.default_rng(1)
    for k, v in vertices.items():
        if k not in fixed:
            v[:3] += 0.05 * v[7] * random.standard_normal(3)
            v[3:7] += 0.02 * random.standard_normal(4)
            v[3:7] /= np.linalg.norm(v[3:7])
            v[7] *= np.exp(0.05 * random.standard_normal())
    folder = tempfile.mkdtemp()
    start, end = os.path.join(folder, "start.g2o"), os.path.join(folder, "end.g2o")
    write(start, vertices, edges, fixed)
    print(subprocess.run([binary, start, end], check=True, capture_output=True, text=True).stdout.strip())
    poses = lambda given: {k: matrix(v) for k, v in given.items()}
    start, ours, theirs = poses(vertices), poses(parse(end)[0]), by_gtsam(vertices, edges, fixed)
    before, our_cost, their_cost = (cost(v, edges) for v in (start, ours, theirs))
    difference = max(np.abs(log(np.linalg.inv(theirs[k]) @ ours[k])).max() for k in vertices)
    print(f"cost: start {before:.3f}, ours {our_cost:.6f}, GTSAM {their_cost:.6f}")
    print(f"largest difference of a pose (tangent): {difference:.2e}")
    ok = our_cost <= their_cost * (1 + 1e-6) + 1e-9 and difference < 1e-3
    print("agree" if ok else "DISAGREE")
    sys.exit(0 if ok else 1)


main()
