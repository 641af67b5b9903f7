"""Starts the node, and with `bundle:=` and `source:=` also the run: ros2 launch probedesign_ros probe.launch.py"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PARAMETERS = {"port": int, "control_port": int, "frame_prefix": str, "publish_tf": bool}
ARGUMENTS = {
    "probedesign": ("probedesign", "the program, or its path in a virtual environment"),
    "bundle": ("", "frozen probe, NAME.probe.json; empty: the run is started elsewhere"),
    "source": ("sim:", "source of the wrenches, as of probedesign live --source"),
    "tare": ("auto", "auto: the first second at rest, when the probe must be free; none: the sensor's own zero"),
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
        parameters=[{name: ParameterValue(value[name], value_type=kind) for name, kind in PARAMETERS.items()}],
    )
    run = ExecuteProcess(
        cmd=[
            value["probedesign"], "live", value["bundle"], "--source", value["source"], "--pose", value["pose"],
            "--tare", value["tare"],
            "--publish", ["ros2://127.0.0.1:", value["port"]], "--control", ["udp://:", value["control_port"]],
            "--lines",
        ],
        condition=IfCondition(NotEqualsSubstitution(value["bundle"], "")),
        output="screen",
    )  # fmt: skip
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, node, run])
