#!/usr/bin/python3
"""What `wingd convert` writes, read by the programs' own readers, and what they write, read by `wingd convert`.

usage: readers.py WINGD   (Debian: python3-opencv, python3-mrcal, python3-yaml)
"""
import subprocess, sys, tempfile, os

import cv2, mrcal, numpy as np, yaml

wingd = sys.argv[1]
CAMERA = dict(width=1280, height=960, fx=2500.5, fy=2499.25, cx=640.5, cy=470.0, k1=-0.1, k2=0.07, p1=1e-4, p2=-2e-4, k3=0.03)
CORE, BROWN = ["fx", "fy", "cx", "cy"], ["k1", "k2", "p1", "p2", "k3"]


def convert(a, b):
    subprocess.run([wingd, "convert", a, b], check=True, stdout=subprocess.DEVNULL)


def camera_toml(path, **changes):
    with open(path, "w") as f:
        for k, v in {**CAMERA, **changes}.items():
            f.write(f"{k} = {v}\n")
    return path


def read_toml(path):
    lines = (l.split(" = ") for l in open(path) if " = " in l)
    return {k: float(v) for k, v in lines}


def same(name, found, want):
    assert np.allclose(found, want, rtol=1e-12, atol=1e-12), (name, found, want)
    print(f"{name}: same")


with tempfile.TemporaryDirectory() as d:
    at = lambda name: os.path.join(d, name)
    core, brown = [CAMERA[k] for k in CORE], [CAMERA[k] for k in BROWN]
    toml = camera_toml(at("camera.toml"))

    convert(toml, at("a.yaml"))
    f = cv2.FileStorage(at("a.yaml"), cv2.FILE_STORAGE_READ)
    m, k = f.getNode("camera_matrix").mat(), f.getNode("distortion_coefficients").mat().ravel()
    same("wingd -> OpenCV", [m[0, 0], m[1, 1], m[0, 2], m[1, 2], *k], core + brown)
    f = cv2.FileStorage(at("b.yaml"), cv2.FILE_STORAGE_WRITE)
    f.write("image_width", 1280), f.write("image_height", 960)
    f.write("camera_matrix", m), f.write("distortion_coefficients", k)
    f.release()
    convert(at("b.yaml"), at("b.toml"))
    same("OpenCV -> wingd", [read_toml(at("b.toml"))[k] for k in CORE + BROWN], core + brown)
    for ending in ("xml", "json"):
        f = cv2.FileStorage(at(f"b.{ending}"), cv2.FILE_STORAGE_WRITE)
        f.write("image_width", 1280), f.write("image_height", 960)
        f.write("camera_matrix", m), f.write("distortion_coefficients", k)
        f.release()
        convert(at(f"b.{ending}"), at(f"b-{ending}.toml"))
        same(f"OpenCV's {ending} -> wingd", [read_toml(at(f"b-{ending}.toml"))[k] for k in CORE + BROWN], core + brown)

    convert(toml, at("a.cameramodel"))
    model = mrcal.cameramodel(at("a.cameramodel"))
    assert model.intrinsics()[0] == "LENSMODEL_OPENCV5" and list(model.imagersize()) == [1280, 960]
    same("wingd -> mrcal", model.intrinsics()[1], core + brown)
    model.write(at("b.cameramodel"))
    convert(at("b.cameramodel"), at("c.toml"))
    same("mrcal -> wingd", [read_toml(at("c.toml"))[k] for k in CORE + BROWN], core + brown)
    points = np.array([[0.2, -0.1, 5.0], [-0.9, 0.5, 4.0]])
    ours = cv2.projectPoints(points, np.zeros(3), np.zeros(3), m, k)[0][:, 0]
    same("one projection in OpenCV and mrcal", mrcal.project(points, *model.intrinsics()), ours)

    for name in ("LENSMODEL_CAHVOR", "LENSMODEL_STEREOGRAPHIC"):
        terms = [2500.5, 2499.25, 640.5, 470.0] + [0.01] * (5 if "CAHVOR" in name else 0)
        mrcal.cameramodel(intrinsics=(name, np.array(terms)), imagersize=(1280, 960)).write(at("other.cameramodel"))
        refused = subprocess.run([wingd, "convert", at("other.cameramodel"), at("no.toml")], capture_output=True, text=True)
        assert refused.returncode == 78 and f'"{name}" is another lens model' in refused.stderr, refused.stderr
        print(f"mrcal's {name} -> wingd: refused by name")

    convert(toml, at("camera_info.yaml"))
    y = yaml.safe_load(open(at("camera_info.yaml")))
    assert y["distortion_model"] == "plumb_bob" and len(y["projection_matrix"]["data"]) == 12
    m = y["camera_matrix"]["data"]
    same("wingd -> ROS", [m[0], m[4], m[2], m[5], *y["distortion_coefficients"]["data"]], core + brown)
    yaml.safe_dump(y, open(at("ros_camera_info.yaml"), "w"))
    convert(at("ros_camera_info.yaml"), at("d.toml"))
    same("ROS -> wingd", [read_toml(at("d.toml"))[k] for k in CORE + BROWN], core + brown)

    flat = camera_toml(at("flat.toml"), k3=0.0)
    convert(flat, at("camchain.yaml"))
    y = yaml.safe_load(open(at("camchain.yaml")))["cam0"]
    same("wingd -> Kalibr", y["intrinsics"] + y["distortion_coeffs"], core + brown[:4])
    yaml.safe_dump({"cam0": y}, open(at("x-camchain.yaml"), "w"))
    convert(at("x-camchain.yaml"), at("e.toml"))
    same("Kalibr -> wingd", [read_toml(at("e.toml"))[k] for k in CORE + BROWN], core + brown[:4] + [0.0])

    terms = ["k4", "k5", "k6"]
    more = dict(k1=0.63, k2=0.005, k3=-0.004, k4=0.97, k5=0.13, k6=-0.014)
    wide, want = camera_toml(at("wide.toml"), **more), core + [{**CAMERA, **more}[k] for k in BROWN + terms]
    convert(wide, at("wide.yaml"))
    f = cv2.FileStorage(at("wide.yaml"), cv2.FILE_STORAGE_READ)
    m, k = f.getNode("camera_matrix").mat(), f.getNode("distortion_coefficients").mat().ravel()
    same("rational: wingd -> OpenCV", [m[0, 0], m[1, 1], m[0, 2], m[1, 2], *k], want)
    convert(wide, at("wide.cameramodel"))
    model = mrcal.cameramodel(at("wide.cameramodel"))
    assert model.intrinsics()[0] == "LENSMODEL_OPENCV8"
    same("rational: wingd -> mrcal", model.intrinsics()[1], want)
    for name in ("wide.yaml", "wide.cameramodel"):
        convert(at(name), at("w.toml"))
        back = read_toml(at("w.toml"))
        same(f"rational: {name} -> wingd", [back[k] for k in CORE + BROWN + terms], want)
