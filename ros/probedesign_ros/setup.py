"""Package of ROS 2, built by colcon as ament_python."""

from setuptools import find_packages, setup

NAME = "probedesign_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/probe.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="probedesign",
    maintainer_email="maintainer@example.com",
    description="Publishes what probedesign live estimates, and offers its commands as services.",
    license="MIT",
    entry_points={"console_scripts": [f"probe = {NAME}.node:main"]},
)
