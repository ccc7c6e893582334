# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The cut of the package, read from the sources: who may import whom, and how long things are."""

from __future__ import annotations

import ast
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'plane_detector'
SOURCES = sorted(PACKAGE.rglob('*.py'))
CORE = sorted(PACKAGE.glob('*.py'))
MOST_FILE_LINES, MOST_FUNCTION_LINES = 300, 40

# Third-party imports of the package, and the rosdep key that brings each.
ROSDEP_KEYS = {
    'cv2': 'python3-opencv', 'numpy': 'python3-numpy',
    'onnxruntime': 'python3-onnxruntime-pip', 'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy', 'skimage': 'python3-skimage', 'sklearn': 'python3-sklearn',
    'threadpoolctl': 'python3-sklearn',  # which depends on it
    'tqdm': 'python3-tqdm', 'yaml': 'python3-yaml'}
# Not in rosdep; imported only where they are used, with an error that says what to install.
EXTRAS = {'pyransac3d', 'onnx', 'torch', 'transformers', 'open3d'}


def modules_imported(path: Path) -> set[str]:
    """Return the full names of all modules that a file imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            names.add(node.module)
            if node.module.split('.')[0] == 'plane_detector':
                names |= {f'{node.module}.{alias.name}' for alias in node.names}
    return names


def packages_imported(path: Path) -> set[str]:
    return {name.split('.')[0] for name in modules_imported(path)}


def is_ros(package: str) -> bool:
    return (package.startswith(('rcl', 'ament_', 'launch', 'rosidl', 'builtin_interfaces'))
            or package.endswith(('_msgs', '_srvs', '_interfaces')))


def core_imports(path: Path) -> set[str]:
    """Return the names of the core's modules that a file imports."""
    core = {module.stem for module in CORE} - {'__init__'}
    return {name.split('.')[1] for name in modules_imported(path)
            if name.startswith('plane_detector.')} & core


@pytest.mark.parametrize('path', CORE, ids=lambda path: path.name)
def test_core_knows_nothing_of_ros_and_of_its_users(path):
    assert not {name for name in packages_imported(path) if is_ros(name)}
    assert not {name for name in modules_imported(path)
                if name.startswith(('plane_detector.ros', 'plane_detector.tools'))}


def test_ros_part_does_not_import_the_tools():
    for path in (PACKAGE / 'ros').glob('*.py'):
        assert not any(name.startswith('plane_detector.tools') for name in modules_imported(path))


def test_heavy_packages_stay_in_one_module_each():
    importers = {package: [path.name for path in [*CORE, *(PACKAGE / 'ros').glob('*.py')]
                           if package in packages_imported(path)]
                 for package in ('onnxruntime', 'pyransac3d')}
    assert importers == {'onnxruntime': ['depth.py'], 'pyransac3d': ['paper.py']}


def test_core_imports_have_no_cycle():
    waiting = {path.stem: core_imports(path) - {path.stem} for path in CORE}
    while waiting:
        free = [name for name, imports in waiting.items() if not imports & set(waiting)]
        assert free, f'these import each other in a circle: {sorted(waiting)}'
        for name in free:
            del waiting[name]


def test_imports_point_from_pipeline_to_stages_to_types():
    assert core_imports(PACKAGE / 'config.py') == {'checked'}
    assert core_imports(PACKAGE / 'checked.py') == core_imports(PACKAGE / 'types.py') == set()
    for path in CORE:
        if path.stem not in ('pipeline', '__init__'):
            assert not core_imports(path) & {'pipeline', 'segmentation'}, path.name


@pytest.mark.parametrize('path', SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_file_has_licence_docstring_and_bounded_length(path):
    text = path.read_text(encoding='utf-8')
    assert text.startswith('# SPDX-FileCopyrightText: 2026 The plane_detector authors\n'
                           '# SPDX-License-Identifier: Apache-2.0\n') or not text
    assert ast.get_docstring(ast.parse(text)) or not text
    assert len(text.splitlines()) <= MOST_FILE_LINES


def test_files_of_tests_are_short_too():
    lengths = {path.name: len(path.read_text(encoding='utf-8').splitlines())
               for path in (ROOT / 'test').rglob('*.py')}
    assert {name: count for name, count in lengths.items() if count > MOST_FILE_LINES} == {}


def test_functions_are_short():
    too_long = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                lines = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                if lines > MOST_FUNCTION_LINES:
                    too_long.append(f'{path.relative_to(ROOT)}:{node.lineno} {node.name} {lines}')
    assert not too_long


def test_package_xml_names_every_import():
    third_party = {package for path in SOURCES for package in packages_imported(path)}
    third_party -= set(sys.stdlib_module_names) | {'plane_detector', '__future__'} | EXTRAS
    declared = {element.text for element in
                ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')}
    needed = {ROSDEP_KEYS.get(package, package) for package in third_party}
    assert needed <= declared
    assert all(is_ros(package) or package in ROSDEP_KEYS for package in third_party)


def test_version_is_the_same_everywhere():
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    assert f"version='{version}'" in (ROOT / 'setup.py').read_text(encoding='utf-8')


def test_public_names_are_found():
    import plane_detector
    for name in plane_detector.__all__:
        assert getattr(plane_detector, name).__module__.startswith('plane_detector.')
    with pytest.raises(AttributeError, match='no attribute'):
        plane_detector.nothing_of_this_name  # noqa: B018


def test_entry_points_lead_to_a_main():
    lines = (ROOT / 'setup.py').read_text(encoding='utf-8').splitlines()
    entries = [line.split("'")[1].split(' = ')[1] for line in lines if ':main' in line]
    assert len(entries) >= 3
    for entry in entries:
        module = entry.removesuffix(':main').replace('{NAME}', 'plane_detector').split('.')
        tree = ast.parse(ROOT.joinpath(*module).with_suffix('.py').read_text(encoding='utf-8'))
        assert 'main' in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
