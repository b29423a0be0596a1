"""Camera files of OpenCV, ROS, Kalibr and mrcal, read and written as ``camera.toml``; Kalibr's boards as ``board.toml``.

All count pixels from the centre of the top-left one and use Brown's distortion in OpenCV's order k1 k2 p1 p2 k3, followed
by k4 k5 k6 of a rational lens.
"""

from wingd.cameras.boards import is_kalibr_board, read_kalibr_board, write_board
from wingd.cameras.model import FORMATS, Camera
from wingd.cameras.reading import ReadCamera, read_camera
from wingd.cameras.writing import write_camera

__all__ = ["FORMATS", "Camera", "ReadCamera", "is_kalibr_board", "read_camera", "read_kalibr_board", "write_board",
           "write_camera"]  # fmt: skip
