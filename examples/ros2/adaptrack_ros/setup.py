"""An ament_python package: `colcon build` calls this."""

from glob import glob

from setuptools import setup

NAME = "adaptrack_ros"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "README.md"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="You",
    maintainer_email="you@example.com",
    description="Path tracking by model predictive control: adaptrack's tracker as a node",
    license="MIT",
    entry_points={
        "console_scripts": [
            f"follower = {NAME}.follower_node:main",
            f"stand_in = {NAME}.stand_in_node:main",
        ]
    },
)
