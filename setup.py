"""Build the package, with `colcon build` on a ROS 2 installation or with `pip install` without ROS."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

# setuptools provides distutils, which Python 3.12 and later do not contain.
from distutils.command.install_data import install_data  # isort: skip

NAME = "diffbot"
"""Name of the ROS package."""
EXECUTABLES = (
    *("controller_node", "docking_node", "ekf_node", "plant_node", "recorder_node", "replay_node", "robot_node"),
    "diffbot",
)
"""Names of functions in diffbot/executables.py."""
LAWS = {
    "switching": "diffbot_control.law.switching:SwitchingLaw",
    "docking": "diffbot_control.law.docking:Docking",
    "paper": "diffbot_control.law.paper:PaperLaw",
    "feedback_linearisation": "diffbot_lab.laws.feedback_linearisation:FeedbackLinearisation",
    "graceful": "diffbot_lab.laws.graceful:Graceful",
    "nav2_docking": "diffbot_lab.laws.nav2_docking:Nav2Docking",
    "nav2_graceful": "diffbot_lab.laws.nav2_graceful:Nav2Graceful",
    "pure_pursuit": "diffbot_lab.laws.pure_pursuit:PurePursuit",
    "rotate_drive_rotate": "diffbot_lab.laws.rotate_drive_rotate:RotateDriveRotate",
}
CONFIGS = {
    "controller": "diffbot_control.ros.parameters.controller:ControllerNodeConfig",
    "paper": "diffbot_control.law.configuration:PaperConfig",
    "docking": "diffbot_control.law.configuration:DockingConfig",
    "ekf": "diffbot_control.ros.parameters.ekf:EkfNodeConfig",
    "dock_ekf": "diffbot_control.ros.parameters.dock:DockEkfConfig",
    "plant": "diffbot_sim.parameters:PlantNodeConfig",
    "recorder": "diffbot_bag.parameters:RecorderConfig",
    "replay": "diffbot_bag.parameters:ReplayConfig",
}
COMMANDS = {
    "benchmark": "diffbot_lab.commands:add_benchmark",
    "campaign": "diffbot_lab.commands:add_campaign",
    "experiment": "diffbot_lab.commands:add_experiment",
    "stability": "diffbot_lab.stability.command:add_stability",
}
SHIM = """\
#!/bin/sh
# For `ros2 run` and `ros2 launch`, which search lib/diffbot; pip installs commands only in bin.
exec "$(dirname "$0")/../../bin/{name}" "$@"
"""


class InstallDataAndShims(install_data):
    """Installs the data files, and a shim lib/diffbot/NAME for each executable, unless colcon installs it there."""

    def run(self) -> None:
        """Install the data files and the shims."""
        super().run()
        folder = Path(self.install_dir, "lib", NAME)
        if Path(self.get_finalized_command("install").install_scripts) == folder:
            return
        folder.mkdir(parents=True, exist_ok=True)
        for name in EXECUTABLES:
            shim = folder / name
            shim.write_text(SHIM.format(name=name), encoding="utf-8")
            shim.chmod(0o755)
            self.outfiles.append(str(shim))


setup(
    name="diffbot-ros",  # on PyPI, the name diffbot belongs to another project; see diffbot_core/installed.py
    version="0.1.0",
    description="Drives a differential-drive robot to a goal pose with a switching law and an EKF",
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 14)),
        "Topic :: Scientific/Engineering",
    ],
    keywords=["robotics", "ROS 2", "differential drive", "Lyapunov", "extended Kalman filter"],
    maintainer="The diffbot authors",
    maintainer_email="diffbot@users.noreply.example",
    python_requires=">=3.10",
    packages=find_packages(include=["diffbot", "diffbot_*"]),
    package_data={
        "": ["py.typed"],
        "diffbot_lab.benchmark": ["*.json"],
        "diffbot_tools": ["*.xml"],
        "diffbot_tools.view": ["page/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (
            f"share/{NAME}/config",
            sorted(glob("config/*.yaml") + glob("config/*.xml") + glob("config/*.json")),
        ),
        (f"share/{NAME}/rviz", sorted(glob("rviz/*.rviz"))),
        (f"share/{NAME}/urdf", sorted(glob("urdf/*.urdf"))),
    ],
    entry_points={
        "console_scripts": [f"{name} = diffbot.executables:{name}" for name in EXECUTABLES],
        "diffbot.commands": [f"{name} = {place}" for name, place in COMMANDS.items()],
        "diffbot.parameters": [f"{name} = {place}" for name, place in CONFIGS.items()],
        "diffbot.controllers": [f"{name} = {place}" for name, place in LAWS.items()],
    },
    cmdclass={"install_data": InstallDataAndShims},
    zip_safe=False,
    # rclpy and the messages belong to a ROS installation, where pip does not find them; see the extra jazzy.
    install_requires=[
        "argcomplete>=2.0",
        "filterpy>=2.0",
        "matplotlib>=3.6",
        "mcap>=1.5",
        "numpy>=1.26",
        "platformdirs>=3.0",
        "PyYAML>=6.0",
        "rosbags>=0.10",  # encodes and decodes messages without ROS
        "ruamel.yaml>=0.17.21",
        "scipy>=1.11",
        "tqdm>=4.60",
        "websockets>=14.0",
    ],
    extras_require={
        "jazzy": ["ros-jazzy-common-interfaces>=5.3", "ros-jazzy-rclpy[fastrtps]>=7.1"],
        "batch": ["numba>=0.60"],
        "cluster": ["distributed>=2024.12"],
        "gym": ["gymnasium>=1.1", "numba>=0.60"],
        "pandas": ["pandas>=2.0"],
        "test": [
            "evo>=1.31",  # reads exported trajectories
            "hypothesis>=6.100",
            "mcap-ros2-support>=0.5",  # decodes messages of recorded bags
            "nbformat>=5.10",  # reads the notebook in examples/
            "playwright>=1.49",
            "pytest>=8.0",
            "pytest-timeout>=2.2",
            "pytest-xdist>=3.5",
            "python-flint>=0.6",  # reference for the interval arithmetic of the certificates
        ],
        "lint": [
            "import-linter>=2.1",
            "mypy>=1.13",
            "oxlint>=1.0",
            "ruff>=0.8",
            "types-PyYAML>=6.0",
        ],
        "docs": ["mkdocs>=1.6", "mkdocs-material>=9.6"],
    },
)
