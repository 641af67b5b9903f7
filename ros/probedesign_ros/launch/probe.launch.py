"""Starts the node, and with `bundle:=` and `source:=` also the run: ros2 launch probedesign_ros probe.launch.py"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import LaunchConfigurationNotEquals
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "probedesign": ("probedesign", "the program, or its path in a virtual environment"),
    "bundle": ("", "frozen probe, NAME.probe.json; empty: the run is started elsewhere"),
    "source": ("sim:", "source of the wrenches, as of probedesign live --source"),
    "pose": ("fixed", "poses of the base, as of probedesign live --pose"),
    "port": ("9001", "UDP port of the messages"),
    "control_port": ("9002", "UDP port of the commands"),
    "frame_prefix": ("", "prefix of the frames sensor, base, world and contact"),
    "publish_tf": ("true", "whether the pose of the base in the world is published as TF"),
}


def generate_launch_description():
    """Return the node and the run."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = Node(
        package="probedesign_ros",
        executable="probe",
        name="probedesign",
        output="screen",
        parameters=[{name: value[name] for name in ("port", "control_port", "frame_prefix", "publish_tf")}],
    )
    run = ExecuteProcess(
        cmd=[
            value["probedesign"], "live", value["bundle"], "--source", value["source"], "--pose", value["pose"],
            "--publish", ["ros2://127.0.0.1:", value["port"]], "--control", ["udp://:", value["control_port"]],
            "--lines",
        ],
        condition=LaunchConfigurationNotEquals("bundle", ""),
        output="screen",
    )  # fmt: skip
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, node, run])
