# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node as a separate process, in a private ROS domain on this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

NODE, FRAME_ID = 'plane_detector', 'camera_optical_frame'
_STOP_TIMEOUT_S = 10.0
_LOG_LINES_SHOWN = 15
# Lets Linux send SIGTERM to the node when its parent, the first argument, ends. Not a preexec_fn:
# with one, Python runs hooks when it forks, which swallow a KeyboardInterrupt.
# derived: 1 is PR_SET_PDEATHSIG of <linux/prctl.h>.
_START = """\
import ctypes, os, runpy, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGTERM)
if os.getppid() == int(sys.argv.pop(1)):
    runpy.run_module('plane_detector.ros.node', run_name='__main__', alter_sys=True)
"""


def use_private_domain() -> None:
    """
    Set the environment of this process and its children for large messages on this machine.

    Must be called before rclpy.init(). Other ROS nodes, on this machine or in the network, are not
    affected and do not interfere. Fast DDS settings of the user are kept.
    """
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)  # above 101 ports may clash
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(_profile()))


def _profile() -> Path:
    """Return the path of the Fast DDS profile: in the sources, or where colcon installs it."""
    name = 'fastdds_large_messages.xml'
    beside = Path(__file__).resolve().parents[3] / 'config' / name
    if beside.is_file():
        return beside
    from ament_index_python.packages import get_package_share_directory
    return Path(get_package_share_directory('plane_detector')) / 'config' / name


class NodeProcess:
    """
    The running node; a context manager that ends it with SIGINT.

    The node also ends if this process ends without leaving the context, as by SIGKILL, or by a
    signal while the node is being started.

    Parameters
    ----------
    parameters : mapping of str to str
        Names and values in YAML.
    log_path : Path
        File for the output of the node.

    """

    def __init__(self, parameters: Mapping[str, str], log_path: Path) -> None:
        self._log_path = log_path
        command = [sys.executable, '-c', _START, str(os.getpid()), '--ros-args']
        for name, value in parameters.items():
            command += ['-p', f'{name}:={value}']
        with open(log_path, 'wb') as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True)  # Ctrl-C reaches only the demo, which ends the node

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def process_id(self) -> int:
        """Process id of the node."""
        return self._process.pid

    def check_running(self) -> None:
        """
        Check that the node is running.

        Raises
        ------
        RuntimeError
            The node has ended; the message quotes its last output.

        """
        if self._process.poll() is not None:
            raise RuntimeError(f'the node ended with exit code {self._process.returncode}.\n'
                               f'{self.last_words()}')

    def last_words(self) -> str:
        """Return the last lines of the node's output."""
        lines = self._log_path.read_text(errors='replace').splitlines()[-_LOG_LINES_SHOWN:]
        return '\n'.join([f'The end of {self._log_path}:', *lines])

    def stop(self) -> int:
        """End the node, by force if it does not react; return its exit code."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return self._process.wait()
