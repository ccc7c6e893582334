# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Imported by tests of bags: they are skipped where rosbags is missing."""

import pytest

pytest.importorskip('rosbags', reason='rosbags, which replay needs, is not installed')
