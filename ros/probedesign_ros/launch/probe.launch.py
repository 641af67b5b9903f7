"""Starts the node, and with `bundle:=` also the run: ros2 launch probedesign_ros probe.launch.py"""

import shlex

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from probedesign_ros.parameters import PARAMETERS

ARGUMENTS = {
    "probedesign": ("probedesign", "the program, or its path in a virtual environment"),
    "bundle": ("", "frozen probe, NAME.probe.json, or several; empty: the run is started elsewhere"),
    "source": ("sim:", "source of the wrenches, as of probedesign live --source; one for each probe"),
    "pose": ("fixed", "poses of the base, as of probedesign live --pose; one for each probe"),
    "tare": ("auto", "auto: the first second at rest, when the probe must be free; none: the sensor's own zero"),
    "options": ("", "all other options of probedesign live, as in a shell: '--rate-hz 50 --record run.mcap'"),
    "use_sim_time": ("false", "whether messages are stamped by the clock of a simulation"),
}
"""Arguments besides the parameters of the node."""


def actions(context):
    """Return the node, and the run, whose end is the end of everything."""
    value = {name: LaunchConfiguration(name).perform(context) for name in (*ARGUMENTS, *PARAMETERS)}
    kinds = {name: type(parameter.default) for name, parameter in PARAMETERS.items()} | {"use_sim_time": bool}
    node = Node(
        package="probedesign_ros",
        executable="probe",
        name="probedesign",
        output="screen",
        parameters=[{name: ParameterValue(value[name], value_type=kind) for name, kind in kinds.items()}],
    )
    if not value["bundle"]:
        return [node]
    pairs = [(f"--{name}", each) for name in ("source", "pose") for each in shlex.split(value[name])]
    run = ExecuteProcess(
        cmd=[
            value["probedesign"], "live", *shlex.split(value["bundle"]), *(word for pair in pairs for word in pair),
            *(() if "--tare" in value["options"] else ("--tare", value["tare"])),
            "--publish", f"ros2://{value['host']}:{value['port']}", "--control", f"udp://:{value['control_port']}",
            "--lines", *shlex.split(value["options"]),
        ],
        output="screen",
        on_exit=Shutdown(reason="the run has ended"),
    )  # fmt: skip
    return [node, run]


def generate_launch_description():
    """Return the arguments and what is started."""
    defaults = ARGUMENTS | {name: (str(p.default), p.text) for name, p in PARAMETERS.items()}
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in defaults.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=actions)])
