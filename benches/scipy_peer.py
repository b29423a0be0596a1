#!/usr/bin/env python3
"""The spatial problem of benches/adjust.rs in size and structure through scipy's least_squares:
21 markers, per marker two pixels in flight, two on ground and three surveyed coordinates; unknown
are 8 + 3 coefficients of curvature and twist, two rotations, the projection centre, the axis'
height and the 63 coordinates. Prints milliseconds per solution (numeric Jacobian, as scipy users
have it at hand, and the sparsity it can exploit)."""
import time

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

N, LENGTH, ROOT, F = 21, 32.5, 0.55, 7800.0
rng = np.random.default_rng(1)
grid = np.linspace(0.0, 1.0, 81)
chord = 1.0 - 0.7 * grid
load = np.sqrt(1.0 - grid**2)
moment = np.array([np.trapezoid((grid[i:] - grid[i]) * load[i:], grid[i:]) for i in range(grid.size)])
shape = moment / chord**3
shape /= np.trapezoid(shape, grid)
basis = shape[:, None] * np.polynomial.legendre.legvander(2 * grid - 1, 7)
step = LENGTH / (grid.size - 1)


def cumulate(f):
    return np.concatenate([[0.0 * f[0]], np.cumsum(0.5 * step * (f[1:] + f[:-1]), axis=0)])


slopes = cumulate(basis)
camera = np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]])
eta = np.linspace(0.19, 0.98, N)
z = np.where(np.arange(N) % 2 == 0, 1.0, -1.2) * (1.6 - 0.7 * eta)
twist_basis = eta[:, None] * np.polynomial.legendre.legvander(2 * eta - 1, 2)


def axis(c, dihedral=0.07):
    theta = dihedral + slopes @ c
    x, y = ROOT + cumulate(np.cos(theta)), -1.8 + cumulate(np.sin(theta))
    return [np.interp(eta, grid, v) for v in (x, y, theta)]


ground_x, ground_y, ground_theta = axis(np.zeros(8))


def rotate(theta, t, n):
    return t * np.cos(theta) - n * np.sin(theta), t * np.sin(theta) + n * np.cos(theta)


def in_flight(c, twist, points, height):
    x, y, theta = axis(c)
    dx, dy = points[:, 0] - ground_x, points[:, 1] - ground_y - height
    t, n = rotate(-ground_theta, dx, dy)
    phi = twist_basis @ twist
    n, w = n * np.cos(phi) - points[:, 2] * np.sin(phi), points[:, 2] * np.cos(phi) + n * np.sin(phi)
    ax, ay = rotate(theta, t, n)
    return np.stack([x + ax, y + ay + height, w], axis=1)


def project(points, rotation):
    q = (points @ camera.T) @ Rotation.from_rotvec(rotation).as_matrix().T
    return F * q[:, :2] / q[:, 2:]


def predict(p):
    points = p[21:].reshape(N, 3)
    flight = in_flight(p[:8], p[8:11], points, p[20])
    centre = p[17:20]
    return (project(flight - centre, p[11:14] + p[14:17]), project(points - centre, p[14:17]), points)


truth = np.zeros(21 + 3 * N)
truth[0], truth[8], truth[11] = 0.0055, 0.04, 8e-4
nx, ny = rotate(ground_theta, np.zeros(N), np.full(N, 0.35))
truth[21:] = np.stack([ground_x + nx, ground_y + ny, z], axis=1).ravel()
seen = [v + rng.normal(size=v.shape) * s for v, s in zip(predict(truth), (0.05, 0.05, 0.002))]
ratio = np.array([0.5, 0.5, 0.4, 0.3, 0.2, 0.15, 0.1]) * 0.0055


def residuals(p):
    parts = [((v - o) / s).ravel() for v, o, s in zip(predict(p), seen, (0.05, 0.05, 0.002))]
    priors = [p[1:8] / ratio, p[8:11] / [0.1, 0.1, 0.02], p[11:14] / (10 / F), p[17:20] / 0.002, p[20:21] / 0.01]
    return np.concatenate(parts + priors)


start = np.zeros_like(truth)
start[21:] = seen[2].ravel()
scale = np.concatenate([np.full(8, 1e-3), np.full(3, 1e-2), np.full(6, 1e-3), np.full(4, 1e-3), np.full(3 * N, 1e-3)])
times = []
for _ in range(5):
    begin = time.perf_counter()
    fit = least_squares(residuals, start, method="trf", x_scale=scale, xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    times.append(time.perf_counter() - begin)
print(f"scipy least_squares, spatial, {N} markers: {1e3 * min(times):.1f} ms, {fit.nfev} evaluations, cost {fit.cost:.1f}")
