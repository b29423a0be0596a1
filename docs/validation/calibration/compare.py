#!/usr/bin/python3
"""OpenCV and mrcal on the corners that `wingd calibrate --corners` wrote (Debian: python3-opencv, python3-mrcal).

Points that wingd did not use are left out. With MODEL_PX, mrcal weights points by their own standard deviation and this
one, which wingd prints as model_sigma_px.

usage: compare.py CORNERS.csv COLUMNS ROWS SQUARE_M [START_F_PX [MODEL_PX]]
"""
import csv, sys, time
import numpy as np

NAMES = ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"]


def read(path):
    pictures = {}
    for row in csv.DictReader(open(path)):
        if row.get("used") == "no":
            continue
        size = (int(row["width_px"]), int(row["height_px"]))
        point = [float(row[k]) for k in ("board_x_m", "board_y_m", "u_px", "v_px", "sigma_u_px", "sigma_v_px")]
        pictures.setdefault(row["image"], (size, []))[1].append(point)
    return [(name, size, np.array(points)) for name, (size, points) in pictures.items()]


def opencv(pictures):
    import cv2

    board = [np.column_stack([p[:, :2], np.zeros(len(p))]).astype(np.float32) for _, _, p in pictures]
    pixels = [p[:, 2:4].astype(np.float32).reshape(-1, 1, 2) for _, _, p in pictures]
    began = time.time()
    out = cv2.calibrateCameraExtended(board, pixels, pictures[0][1], None, None)
    rms, camera, d, sigma = out[0], out[1], out[2].ravel(), out[5].ravel()
    values = [camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2], d[0], d[1], d[4], d[2], d[3]]
    sigmas = [sigma[k] for k in (0, 1, 2, 3, 4, 5, 8, 6, 7)]
    return dict(rms=rms, values=values, sigmas=sigmas, bow=None, seconds=time.time() - began)


def mrcal_(pictures, columns, rows, square, focal, warp=True, weighted=False):
    import mrcal

    size = pictures[0][1]
    n = len(pictures)
    observed = np.zeros((n, rows, columns, 3))
    observed[..., 2] = -1
    for k, (_, _, points) in enumerate(pictures):
        i = np.rint(points[:, 0] / square).astype(int)
        j = np.rint(points[:, 1] / square).astype(int)
        observed[k, j, i, :2] = points[:, 2:4]
        sigma = np.sqrt((points[:, 4] ** 2 + points[:, 5] ** 2) / 2)
        observed[k, j, i, 2] = 0.1 / np.hypot(sigma, MODEL) if weighted else 1
    intrinsics = np.array([[focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2, 0, 0, 0, 0, 0]])
    index = np.array([[k, 0, -1] for k in range(n)], dtype=np.int32)
    pinhole = ("LENSMODEL_PINHOLE", intrinsics[0, :4])
    frames = mrcal.estimate_monocular_calobject_poses_Rt_tocam(index, observed, square, [pinhole])
    arguments = dict(
        lensmodel="LENSMODEL_OPENCV5",
        intrinsics=intrinsics,
        extrinsics_rt_fromref=np.zeros((0, 6)),
        frames_rt_toref=mrcal.rt_from_Rt(frames),
        points=None,
        observations_board=observed,
        indices_frame_camintrinsics_camextrinsics=index,
        observations_point=None,
        indices_point_camintrinsics_camextrinsics=None,
        imagersizes=np.array([size], dtype=np.int32),
        calobject_warp=np.array([1e-4, 1e-4]),
        calibration_object_spacing=square,
        do_optimize_calobject_warp=warp,
        do_apply_regularization=False,
        do_apply_outlier_rejection=False,
        verbose=False,
    )
    began = time.time()
    for stage in (dict(do_optimize_intrinsics_distortions=False, do_optimize_calobject_warp=False), {}):
        result = mrcal.optimize(**{**arguments, **stage})
    # A plane seen nearly square has two attitudes: the better one with this lens, and once more from there.
    import cv2

    found = arguments["intrinsics"][0]
    for k, (_, _, points) in enumerate(pictures):
        plane = np.column_stack([points[:, :2], np.zeros(len(points))])
        lens = np.array([[found[0], 0, found[2]], [0, found[1], found[3]], [0, 0, 1]]), found[4:]
        _, turns, shifts, _ = cv2.solvePnPGeneric(plane, points[:, 2:4].copy(), *lens, flags=cv2.SOLVEPNP_IPPE)
        arguments["frames_rt_toref"][k] = np.concatenate([turns[0].ravel(), shifts[0].ravel()])
    result = mrcal.optimize(**arguments)
    seconds = time.time() - began
    x = result["x"]
    measurements = x[: mrcal.num_measurements_boards(**arguments)]
    used = int((observed[..., 2] > 0).sum())
    # The standard deviation of a coordinate, from the residuals.
    state = 9 + 6 * n + (2 if warp else 0)
    unit = np.sqrt((measurements**2).sum() / (2 * used - state))
    _, _, jacobian, _ = mrcal.optimizer_callback(**arguments, no_factorization=True)
    j = jacobian.toarray()
    scale = np.sqrt((j**2).sum(0))
    scale[scale == 0] = 1
    covariance = np.linalg.inv((j / scale).T @ (j / scale)) / np.outer(scale, scale) * unit**2
    # The Jacobian is of the packed state.
    sigma = np.sqrt(np.diag(covariance))
    mrcal.unpack_state(sigma, **arguments)
    v = arguments["intrinsics"][0]
    order = [0, 1, 2, 3, 4, 5, 8, 6, 7]
    bow = arguments["calobject_warp"]
    return dict(
        rms=np.sqrt((measurements**2).sum() / used),
        values=[v[k] for k in order],
        sigmas=[sigma[k] for k in order],
        bow=list(zip(bow, sigma[-2:])) if warp else None,
        seconds=seconds,
    )


MODEL = 0.0
if __name__ == "__main__":
    pictures = read(sys.argv[1])
    columns, rows, square = int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    first = opencv(pictures)
    focal = float(sys.argv[5]) if len(sys.argv) > 5 else first["values"][0]
    MODEL = float(sys.argv[6]) if len(sys.argv) > 6 else 0.0
    results = {
        "OpenCV": first,
        "mrcal, flat board": mrcal_(pictures, columns, rows, square, focal, warp=False),
        "mrcal": mrcal_(pictures, columns, rows, square, focal),
    }
    if MODEL > 0:
        results["mrcal, weighted"] = mrcal_(pictures, columns, rows, square, focal, weighted=True)
    for name, r in results.items():
        print(f"{name}: rms {r['rms']:.4f} px, {r['seconds']:.2f} s")
        for n, v, s in zip(NAMES, r["values"], r["sigmas"]):
            print(f"  {n} {v:.6f} +- {s:.6f}")
        if r["bow"]:
            print("  bow " + ", ".join(f"{1e3 * v:.3f} +- {1e3 * s:.3f} mm" for v, s in r["bow"]))
