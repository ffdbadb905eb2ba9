"""The node with a file of parameters, and RViz if it is asked for.

ros2 launch extra/monogrid-ros2/launch/monogrid.launch.py params_file:=monogrid.yaml rviz:=true

`monogrid-ros2` must be on the path (cargo install --path extra/monogrid-ros2).
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

DEPLOY = Path(__file__).resolve().parent.parent / "deploy"


def generate_launch_description():
    params, namespace, rviz = map(LaunchConfiguration, ("params_file", "namespace", "rviz"))
    node = ["monogrid-ros2", "--ros-args", "--params-file", params, "-r", ["__ns:=", namespace]]
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(DEPLOY / "monogrid.yaml")),
            DeclareLaunchArgument("namespace", default_value="/"),
            DeclareLaunchArgument("rviz", default_value="false"),
            ExecuteProcess(cmd=node, output="screen", sigterm_timeout="60"),
            ExecuteProcess(cmd=["rviz2", "-d", str(DEPLOY / "monogrid.rviz")], condition=IfCondition(rviz)),
        ]
    )
