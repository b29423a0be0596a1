#!/usr/bin/python3
"""What `wingd convert` writes, read by the programs' own readers, and what they write, read by `wingd convert`.

usage: readers.py WINGD [ROS_CONVERT [KALIBR_READER]]   (Debian: python3-opencv, python3-mrcal, python3-yaml)

ROS_CONVERT is `convert` of camera_calibration_parsers (Debian: camera-calibration-parsers-tools), KALIBR_READER is
Kalibr's kalibr_common/ConfigReader.py, of which the parts that read and write files are used.
"""
import importlib.util, subprocess, sys, tempfile, os, types

import cv2, mrcal, numpy as np, yaml

wingd, ros_convert, kalibr_reader = (sys.argv[1:] + [None, None])[:3]
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


def by_ros(a, b):
    """A file through ROS's own parser and writer."""
    said = subprocess.run([ros_convert, a, b], capture_output=True, text=True)
    assert said.returncode == 0 and os.path.exists(b), said


def by_kalibr(file, again):
    """A camera of a chain by Kalibr's reader, and the chain by Kalibr's writer."""
    for name in ("aslam_cv", "aslam_cv_backend", "sm"):
        sys.modules[name] = types.ModuleType(name)
    spec = importlib.util.spec_from_file_location("ConfigReader", kalibr_reader)
    reader = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reader)
    chain = reader.CameraChainParameters(file)
    camera = chain.getCameraParameters(0)
    (model, core), (distortion, terms) = camera.getIntrinsics(), camera.getDistortion()
    assert (model, distortion, camera.getResolution()) == ("pinhole", "radtan", [1280, 960])
    chain.writeYaml(again)
    return core + terms


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

    # Small round terms, which YAML 1.1 takes for texts where they are written as 1e-5.
    small = dict(p1=1e-5, p2=-3e-7)
    small_toml, want_small = camera_toml(at("small.toml"), **small), core + [{**CAMERA, **small}[k] for k in BROWN]
    convert(small_toml, at("small_camera_info.yaml"))
    y = yaml.safe_load(open(at("small_camera_info.yaml")))
    same("small terms: wingd -> PyYAML", y["distortion_coefficients"]["data"], want_small[4:])
    if ros_convert:
        by_ros(at("small_camera_info.yaml"), at("by_ros_camera_info.yaml"))
        convert(at("by_ros_camera_info.yaml"), at("by_ros.toml"))
        same("wingd -> ROS's parser -> wingd", [read_toml(at("by_ros.toml"))[k] for k in CORE + BROWN], want_small)
        wide_ros = camera_toml(at("wide_ros.toml"), k4=0.01, k5=0.001, k6=1e-5)
        convert(wide_ros, at("wide_camera_info.yaml"))
        by_ros(at("wide_camera_info.yaml"), at("wide_by_ros_camera_info.yaml"))
        convert(at("wide_by_ros_camera_info.yaml"), at("wide_by_ros.toml"))
        back = read_toml(at("wide_by_ros.toml"))
        same("rational: wingd -> ROS's parser -> wingd", [back[k] for k in ("k4", "k5", "k6")], [0.01, 0.001, 1e-5])
    else:
        print("ROS's own parser: not given, not tried")
    flat_small = camera_toml(at("flat_small.toml"), k3=0.0, **small)
    convert(flat_small, at("small-camchain.yaml"))
    if kalibr_reader:
        same("wingd -> Kalibr's reader", by_kalibr(at("small-camchain.yaml"), at("again-camchain.yaml")), want_small[:8])
        convert(at("again-camchain.yaml"), at("again.toml"))
        same("Kalibr's writer -> wingd", [read_toml(at("again.toml"))[k] for k in CORE + BROWN], want_small[:8] + [0.0])
    else:
        print("Kalibr's own reader: not given, not tried")

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
