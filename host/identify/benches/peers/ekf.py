"""The four-state EKF of host/identify/src/ekf in matrix form, in NumPy. usage: ekf.py FOLDER"""

import json
import pathlib
import sys
import time

import numpy as np

folder = pathlib.Path(sys.argv[1])
model = json.loads((folder / "model.json").read_text())
data = np.fromfile(folder / "data.f64", dtype="<f8").reshape(-1, 2)
P = np.zeros((4, 4))
P[np.triu_indices(4)] = model["p0"]
P = P + np.triu(P, 1).T
x = np.array(model["x0"])
F = np.eye(4)
F[0, 1] = model["f12"]
Q, R, I4 = np.diag(model["q"]), np.diag(model["r"]), np.eye(4)
H = np.zeros((2, 4))
H[0, 0] = 1.0
started = time.perf_counter()
for y in data:
    x = F @ x
    P = F @ P @ F.T + Q
    H[1] = x[2], x[3], x[0], x[1]
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, (P @ H.T).T).T
    x = x + K @ (y - np.array([x[0], x[0] * x[2] + x[1] * x[3]]))
    P = (I4 - K @ H) @ P
seconds = time.perf_counter() - started
report = {"seconds": seconds, "samples": len(data), "x": x.tolist(), "version": np.__version__}
print(json.dumps(report))
