# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Build script of the ament_python package."""

from glob import glob

from setuptools import find_packages, setup

NAME = 'plane_detector'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(
        include=[NAME, f'{NAME}.*'],
        exclude=[f'{NAME}.evaluation', f'{NAME}.evaluation.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml', 'LICENSE']),
        (f'share/{NAME}/docs', sorted(glob('docs/*.md'))),
        (f'share/{NAME}/docs/figures', sorted(glob('docs/figures/*'))),
        (f'share/{NAME}/config', sorted(glob('config/*'))),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
        (f'share/{NAME}/examples', sorted(glob('docs/examples/*'))),
    ],
    python_requires='>=3.10',
    # OpenCV: the wheels before 4.8.1.78 hold
    # a libwebp with CVE-2023-4863; rosdep brings Ubuntu's own instead, and webp is not decoded.
    install_requires=[
        'joblib>=1.3', 'numba>=0.58', 'numpy>=1.26', 'opencv-python-headless>=4.8.1.78',
        'pyyaml', 'scikit-learn', 'scipy', 'setuptools', 'threadpoolctl>=3.0', 'tqdm'],
    # Depth networks need one of cpu and gpu, whose packages share a module. Loading a network can
    # be stopped from 1.22 on.
    extras_require={
        'benchmark': ['matplotlib', 'pillow', 'pyransac3d'],
        'cpu': ['onnxruntime>=1.22'],
        'dask': ['dask[distributed]'],
        'demo': ['scikit-image'],
        'export': ['onnx', 'torch', 'transformers'],
        'gpu': ['onnxruntime-gpu[cuda,cudnn]>=1.22'],
        'paper': ['pyransac3d'],
        'ray': ['ray'],
        'replay': ['rosbags'],
        'test': ['onnx', 'pytest'],
    },
    zip_safe=True,
    maintainer='The plane_detector authors',
    maintainer_email='maintainers@plane-detector.invalid',
    description='Planes from one ordinary camera: labelled points and plane '
                'equations from monocular depth.',
    license='Apache-2.0',
    entry_points={'console_scripts': [
        f'node = {NAME}.ros.node:main',
        f'demo = {NAME}.tools.demo.__main__:main',
        f'export = {NAME}.tools.export:main',
        f'fetch = {NAME}.tools.fetch:main',
        f'replay = {NAME}.tools.replay.__main__:main',
        f'rviz = {NAME}.tools.rviz:main',
        f'show = {NAME}.tools.show:main',
    ]},
)
