# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 side: messages in, messages out. The method itself is in the other packages."""
