# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Imported by tests of networks: they are skipped where ONNX Runtime is missing."""

import pytest

pytest.importorskip('onnxruntime', reason='ONNX Runtime, which networks need, is not installed')
