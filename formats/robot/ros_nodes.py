"""ROS nodes for which `locfuse export ros` writes parameters: their known keys, and their section in a file.

Sources of the keys: robot_localization (state_estimation_nodes), nav2 (configuring-amcl), ros2_controllers
(parameters of diff_drive_controller), FusionCore (docs/configuration.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from locfuse.formats.visible import visible
from locfuse.fusion.data import LocfuseError

from . import robot_localization as ekf
from .ros_yaml import NodeSection, RosFile

OF_EVERY_NODE = ("use_sim_time", r"qos_overrides\..+", "<<")


class RosNode(NamedTuple):
    """One kind of node."""

    name: str  # of the package or plugin
    usual: str  # default name of the node
    distinctive: str  # pattern of keys that occur only in sections of this kind of node
    example: str  # example of distinctive keys, for errors
    known: tuple[str, ...]  # patterns of all keys of the node
    plugin: str = ""  # type of the controller in the controller manager


NODES = {
    "diff_drive": RosNode(
        "diff_drive_controller",
        "diff_drive_controller",
        r"wheel_separation(_multiplier)?",
        "wheel_separation",
        (
            "type",
            r"(left|right)_wheel(_names)?",
            r"wheel_separation(_multiplier)?",
            r"((left|right)_)?wheel_radius(_multiplier)?",
            r"(odom|base)_frame_id|tf_frame_prefix(_enable)?|enable_odom_tf",
            r"(pose|twist)_covariance_diagonal",
            r"open_loop|position_feedback|wheels_per_side|cmd_vel_timeout|velocity_rolling_window_size",
            r"publish_(rate|cmd|limited_velocity|wheel_joint_controller_state|wheel_data)",
            r"update_rate|use_stamped_vel|allow_multiple_cmd_vel_publishers|estimate_velocity_from_position",
            r"(linear|angular)\.[xz]\..+",
        ),
        "diff_drive_controller",
    ),
    "ekf": RosNode(
        "robot_localization",
        "ekf_filter_node",
        ekf.INPUT.pattern,
        "odom0, imu0",
        (
            *ekf.USED,
            *ekf.IDLE,
            *ekf.UNUSED,
            ekf.INPUT.pattern,
            *(rf"({ekf.INPUT.pattern})_{key}" for key in ekf.KNOWN_OF_INPUT),
        ),
    ),
    "amcl": RosNode(
        "amcl",
        "amcl",
        r"alpha1|sigma_hit|laser_model_type",
        "alpha1, sigma_hit",
        (
            r"alpha[1-5]|sigma_hit|z_(hit|max|rand|short)|lambda_short|update_min_[ad]|robot_model_type",
            r"(base|global|odom)_frame_id|scan_topic|map_topic|use_map_topic|first_map_only|tf_broadcast",
            r"do_beamskip|beam_skip_(distance|error_threshold|threshold)|max_beams|(min|max)_particles",
            r"laser_(likelihood_max_dist|max_range|min_range|model_type)|(pf|kld)_(err|z)|resample_interval",
            r"recovery_alpha_(fast|slow)|save_pose_rate|transform_tolerance|random_seed|freespace_downsampling",
            r"(always_re)?set_initial_pose|always_reset_initial_pose|initial_pose(\.(x|y|z|yaw))?",
            r"bond_(heartbeat_period|timeout)|(service_)?introspection_mode|use_cluster_averaging",
        ),
    ),
    "fusioncore": RosNode(
        "FusionCore",
        "fusioncore",
        r"imu\.gyro_noise|encoder\.(vel|yaw)_noise|gnss\.base_noise_xy",
        "imu.gyro_noise, encoder.vel_noise",
        (
            r"(base|odom|map)_frame|publish_rate|motion_model|max_measurement_delay|outlier_rejection",
            r"outlier_threshold_(gnss|imu|enc|hdg|vslam)",
            r"imu2?\.(topic|(gyro|accel)_noise|has_magnetometer|remove_gravitational_acceleration|frame_id)",
            r"imu2?\.(lever_arm_[xyz]|fixed_rate_hz)",
            r"encoder2?\.(topic|(vel|yaw)_noise|channels|nhc_(vy_sigma|auto_detect))",
            r"gnss\.((fix2?|velocity|heading|azimuth)_topic|base_noise_(xy|z)|heading_noise|use_gps_fix)",
            r"gnss\.((min|max)_sigma_(xy|z)|max_[hv]dop|min_satellites|min_fix_type|max_speed(_\w+)?)",
            r"gnss\.(lever_arm2?_[xyz]|lever_arm_max_heading_sigma_deg|apply_lever_arm_pre_heading)",
            r"gnss\.(coast|recovery|p_inflate|track_heading|rotation_heading|continuity|outlier)_\w+",
            r"magnetometer\.(enabled|topic|noise_rad|chi2_threshold|declination_rad|(hard|soft)_iron)",
            r"magnetometer\.field_(strength|tolerance)",
            r"(publish|radar|vslam|adaptive|ukf|init|zupt|motion_model_params|replay|reference)\..+",
            r"(input|output|ground_constraint)\..+",
        ),
    ),
}


def sections_of(file: RosFile, target: str) -> list[NodeSection]:
    """Return the sections of a file that belong to a kind of node (a key of NODES)."""
    return [s for s in file.sections if any(re.fullmatch(NODES[target].distinctive, key) for key in s.at)]


def section_of(file: RosFile, target: str, name: str | None = None) -> NodeSection:
    """Return the only section of a kind of node in a file; `name` selects one of several nodes.

    Raises LocfuseError for no section or several, another controller type, or unknown keys.
    """
    node, types = NODES[target], dict(_types(file))
    found = sections_of(file, target)
    if name is not None:
        found = [s for s in found if name in {s.name, s.name.rpartition("/")[2]}]
    if not found:
        named = f" named {name}" if name else ""
        others = f"; its controllers: {', '.join(f'{n} ({t})' for n, t in types.items())}" if types else ""
        example = f"({node.example}){others if node.plugin else ''}"
        raise LocfuseError(f"{file.path} has no section of {node.name}{named} {example}")
    if len(found) > 1:
        names = ", ".join(visible(s.name) for s in found)
        words = f"several sections of {node.name} ({names}): choose one with --node NAME"
        raise LocfuseError(f"{file.path} has {words}")
    section = found[0]
    kind = str(section.values.get("type") or types.get(section.name.rpartition("/")[2], ""))
    if node.plugin and kind and node.plugin not in kind:
        raise LocfuseError(f"{file.path}: {visible(section.name)} is a {visible(kind)}, not a {node.plugin}")
    patterns = (*node.known, *OF_EVERY_NODE)
    for key in section.at:
        if not any(re.fullmatch(pattern, key) for pattern in patterns):
            words = f"{node.name} has no key {visible(key[:60])}: correct it or take it out"
            raise LocfuseError(f"{file.path}: {visible(section.name)}: {words}")
    return section


def _types(file: RosFile) -> Iterator[tuple[str, str]]:
    """Yield (name, type) of every controller that the file's controller managers declare."""
    for section in file.sections:
        for key, value in section.values.items():
            if key.endswith(".type") and isinstance(value, str):
                yield visible(key.removesuffix(".type")), visible(value)
