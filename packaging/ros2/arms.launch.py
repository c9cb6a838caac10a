"""Controllers of ROS 2 for the arms of rubik-robot: docs/ros.md.

    rubik-robot urdf scenarios/ros_arms.toml > cell.urdf
    ros2 launch packaging/ros2/arms.launch.py urdf:=cell.urdf

Start the router of rmw_zenoh and `rubik-robot run scenarios/ros_arms.toml --speed 1 --ros` before:
the controllers begin at the joint states of the run. The program publishes /tf itself, so the
robot_state_publisher here only gives the controllers their description.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = os.path.dirname(os.path.abspath(__file__))
PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("urdf", description="output of rubik-robot urdf"),
        DeclareLaunchArgument("plugin", default_value=PLUGIN, description="hardware interface"),
    ]
    # A relative path means the folder of the command, not that of the xacro file.
    urdf = PathJoinSubstitution([os.getcwd(), LaunchConfiguration("urdf")])
    description = Command(
        ["xacro ", os.path.join(HERE, "arms.ros2_control.xacro"),
         " urdf:=", urdf, " plugin:=", LaunchConfiguration("plugin")])
    manager = Node(
        package="controller_manager",
        executable="ros2_control_node",
        parameters=[
            {"robot_description": ParameterValue(description, value_type=str)},
            os.path.join(HERE, "controllers.yaml"),
        ],
        # The run publishes a description without ros2_control under this name.
        remappings=[("/robot_description", "/robot_description_of_controllers"),
                    ("~/robot_description", "/robot_description_of_controllers")],
        output="screen",
    )
    publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
        # Only the description is wanted of it: the run publishes the transforms.
        remappings=[("robot_description", "/robot_description_of_controllers"),
                    ("/tf", "/unused_tf"), ("/tf_static", "/unused_tf_static")],
    )
    controllers = Node(
        package="controller_manager",
        executable="spawner",
        arguments=["track_controller", "postument_controller"],
    )
    return LaunchDescription(arguments + [manager, publisher, controllers])
