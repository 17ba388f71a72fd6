"""The wheel: every package under tacgen/, and recipes and objects as data in tacgen/shipped/."""

from setuptools import find_packages, setup

DATA = {"tacgen.shipped.recipes": "recipes", "tacgen.shipped.objects": "objects"}

setup(packages=[*find_packages(include=["tacgen", "tacgen.*"]), *DATA], package_dir=DATA)
