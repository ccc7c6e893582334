# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The structure of the package, read from the sources: allowed imports."""

import ast
import sys
import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import pytest
from setuptools import find_packages

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'plane_detector'
SOURCES = sorted(PACKAGE.rglob('*.py'))
# A layer imports those before it; the rooms of one layer do not import each other.
LAYERS = (('_runtime',), ('settings', 'stage_timer'),
          ('plane_fields',), ('config', 'types'), ('geometry',),
          ('depth', 'directions', 'segmentation', 'scale', 'tracking'), ('planes',),
          ('ground', 'shapes', 'mapping', 'network_steps'),
          ('pipeline', 'drawing'), ('ros',), ('tools',), ('evaluation',))
# The same inside the segmentation, and what planes may know of it.
SEGMENTATION_LAYERS = (('cells',), ('memory',), ('search',), ('regions',), ('pixels',),
                       ('fine_pass',), ('segment',), ('baselines',))
PLANES_MAY_IMPORT = 'plane_detector.segmentation.cells'
CORE = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] not in
        ('ros', 'tools', 'evaluation')]
TESTS = sorted((ROOT / 'test').rglob('*.py'))

# Third-party imports of the package, and the rosdep key that brings each.
ROSDEP_KEYS = {
    'cv2': 'python3-opencv',
    'joblib': 'python3-joblib',
    'numba': 'python3-numba', 'numpy': 'python3-numpy',
    'onnxruntime': 'python3-onnxruntime-pip', 'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy', 'sklearn': 'python3-sklearn',
    'tf2_ros': 'tf2_ros_py', 'threadpoolctl': 'python3-sklearn',  # which depends on it
    'tqdm': 'python3-tqdm', 'yaml': 'python3-yaml'}
# Not in rosdep; imported only where they are used, with an error that says what to install.
EXTRAS = {'PIL', 'dask', 'matplotlib', 'onnx', 'pyransac3d', 'ray', 'skimage', 'torch',
          'transformers', 'vision_msgs'}


@cache
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


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix('').parts[0]


@cache
def imports_of_package(path: Path) -> set[str]:
    """Return the package's modules that a file imports."""
    modules = {module_of(source) for source in SOURCES}
    return {name for name in modules_imported(path) & modules if name.count('.')}


def rank(layers: tuple[tuple[str, ...], ...], room: str) -> int:
    ranks = [k for k, rooms in enumerate(layers) if room in rooms]
    table = 'LAYERS' if layers is LAYERS else 'SEGMENTATION_LAYERS'
    assert ranks, f'{room} has no layer: add it to {table} in {Path(__file__).name}'
    return ranks[0]


def may_import(importer: str, imported: str) -> bool:
    """Tell whether the layers allow an import."""
    if importer.count('.') == 0:
        return False
    (_, a, *deeper_a), (_, b, *deeper_b) = importer.split('.'), imported.split('.')
    if a in ('planes', 'shapes') and b == 'segmentation':
        return imported.startswith(PLANES_MAY_IMPORT)
    if a == b == 'segmentation' and deeper_a and deeper_b:
        a, b = deeper_a[0], deeper_b[0]
        return a == b or rank(SEGMENTATION_LAYERS, b) < rank(SEGMENTATION_LAYERS, a)
    return a == b or rank(LAYERS, b) < rank(LAYERS, a)


def packages_imported(path: Path) -> set[str]:
    return {name.split('.')[0] for name in modules_imported(path)}


def is_ros(package: str) -> bool:
    return (package.startswith(('rcl', 'ament_', 'launch', 'rosidl', 'tf2', 'builtin_interfaces'))
            or package.endswith(('_msgs', '_srvs', '_interfaces')))


def test_core_does_not_import_ros():
    assert not [f'{path.relative_to(PACKAGE)} imports {name}' for path in CORE
                for name in packages_imported(path) if is_ros(name)]


def test_heavy_packages_stay_in_one_module_each():
    importers = {package: [str(path.relative_to(PACKAGE)) for path in SOURCES
                           if room_of(path) != 'evaluation' and package in packages_imported(path)]
                 for package in ('onnxruntime', 'pyransac3d')}
    assert importers == {'onnxruntime': ['depth/onnx_session.py'],
                         'pyransac3d': ['segmentation/baselines.py']}


def test_modules_do_not_import_each_other_in_a_circle():
    modules = {module_of(path) for path in SOURCES}
    waiting = {module_of(path): modules_imported(path) & modules - {module_of(path)}
               for path in SOURCES}
    while waiting:
        free = [name for name, imports in waiting.items() if not imports & set(waiting)]
        assert free, f'these import each other in a circle: {sorted(waiting)}'
        for name in free:
            del waiting[name]


def test_imports_point_one_way():
    wrong = [f'{path.relative_to(PACKAGE)} imports {name}' for path in SOURCES
             for name in imports_of_package(path) if not may_import(module_of(path), name)]
    assert not wrong


def test_private_names_stay_in_their_file():
    wrong = [f'{path.relative_to(PACKAGE)}: {alias.name}' for path in SOURCES
             for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
             if isinstance(node, ast.ImportFrom) for alias in node.names
             if alias.name.startswith('_') and node.module != '__future__']
    assert not wrong


def test_files_have_licence_and_docstring():
    licence = ('# SPDX-FileCopyrightText: 2026 The plane_detector authors\n'
               '# SPDX-License-Identifier: Apache-2.0\n')
    texts = {path: path.read_text(encoding='utf-8') for path in SOURCES}
    assert not [path for path, text in texts.items()
                if text and not (text.startswith(licence) and ast.get_docstring(ast.parse(text)))]


def can_fail(test: ast.FunctionDef) -> bool:
    """Say whether a test has an assert or calls one, pytest.raises and the like among them."""
    called = {getattr(node.func, 'attr', getattr(node.func, 'id', ''))
              for node in ast.walk(test) if isinstance(node, ast.Call)}
    return (any(isinstance(node, ast.Assert) for node in ast.walk(test))
            or bool(called & {'raises', 'warns', 'fail'})
            or any(name.startswith('assert') for name in called))


def test_every_test_can_fail():
    assert [f'{path.relative_to(ROOT)} {node.name}' for path in TESTS
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
            and node.name.startswith('test_') and not can_fail(node)] == []


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


def test_evaluation_is_not_installed():
    call = next(node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text('utf-8')))
                if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'find_packages')
    options = {option.arg: eval(compile(ast.Expression(option.value), 'setup.py', 'eval'),
                                {'NAME': 'plane_detector'}) for option in call.keywords}
    found = find_packages(str(ROOT), **options)
    assert {'plane_detector.ros', 'plane_detector.tools.replay'} <= set(found)
    assert not [name for name in found if 'evaluation' in name]
    assert {name.split('.')[0] for name in found} == {PACKAGE.name}
