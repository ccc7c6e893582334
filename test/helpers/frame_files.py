# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Writing of the frames of a data folder."""

import json

import cv2
import numpy as np


def write_frame(folder, depth_mm):
    folder.mkdir()
    about = {'fx': 131.0, 'fy': 131.0, 'cx': 79.5, 'cy': 59.5, 'width': 160, 'height': 120,
             'depth_unit_m': 0.001, 'invalid': 0}
    (folder / 'intrinsics.json').write_text(json.dumps(about))
    cv2.imwrite(str(folder / '7_depth.png'), depth_mm)
    cv2.imwrite(str(folder / '7_rgb.png'), np.full((120, 160, 3), (10, 20, 30), np.uint8))
