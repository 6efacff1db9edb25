"""The ROS package of jaxplore: launch files and settings. The program itself comes from pip."""

from glob import glob

from setuptools import setup

setup(
    name="jaxplore-launch",
    version="0.1.0",
    license="Apache-2.0",
    packages=[],
    py_modules=[],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/jaxplore"]),
        ("share/jaxplore", ["package.xml"]),
        ("share/jaxplore/launch", glob("launch/*.launch.py")),
        ("share/jaxplore/config", glob("config/*.yaml")),
    ],
)
