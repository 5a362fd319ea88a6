"""What detectors of tags and objects publish."""

from __future__ import annotations

from .known_parts import COVARIANCE, DIVIDER, HEADER, POSE

TAG = (
    f"{DIVIDER}\nMSG: apriltag_msgs/AprilTagDetection\nstring family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\napriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
    f"{DIVIDER}\nMSG: apriltag_msgs/Point\nfloat64 x\nfloat64 y\n"
)
STAMPED = (
    f"{DIVIDER}\nMSG: geometry_msgs/PoseWithCovarianceStamped\n{HEADER}geometry_msgs/PoseWithCovariance pose\n"
)
ISAAC = (
    f"{DIVIDER}\nMSG: isaac_ros_apriltag_interfaces/AprilTagDetection\nstring family\nint32 id\n"
    "geometry_msgs/Point center\ngeometry_msgs/Point[4] corners\n"
    f"geometry_msgs/PoseWithCovarianceStamped pose\n{STAMPED}{COVARIANCE}{POSE}"
)
BOARDS = (
    f"{DIVIDER}\nMSG: aruco_opencv_msgs/MarkerPose\nuint16 marker_id\ngeometry_msgs/Pose pose\n"
    f"{DIVIDER}\nMSG: aruco_opencv_msgs/BoardPose\nstring board_name\ngeometry_msgs/Pose pose\n{POSE}"
)
MARKERS = HEADER + "aruco_msgs/Marker[] markers\n" + f"{DIVIDER}\nMSG: aruco_msgs/Marker\n{HEADER}uint32 id\n"
CORNERS = "geometry_msgs/Point[] corners\ngeometry_msgs/Point center\n"  # some releases say them
MARKER = f"geometry_msgs/PoseWithCovariance pose\nfloat64 confidence\n{COVARIANCE}{POSE}"
# vision_msgs 4 (Humble); in version 3 a centre is a geometry_msgs/Pose2D, which is laid out alike.
HYPOTHESES = (
    f"{DIVIDER}\nMSG: vision_msgs/ObjectHypothesisWithPose\nvision_msgs/ObjectHypothesis hypothesis\n"
    f"geometry_msgs/PoseWithCovariance pose\n{DIVIDER}\nMSG: vision_msgs/ObjectHypothesis\nstring class_id\n"
    f"float64 score\n{COVARIANCE}{POSE}"
)
BOX_2D = (
    f"{DIVIDER}\nMSG: vision_msgs/BoundingBox2D\nvision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n"
    f"{DIVIDER}\nMSG: vision_msgs/Pose2D\nvision_msgs/Point2D position\nfloat64 theta\n"
    f"{DIVIDER}\nMSG: vision_msgs/Point2D\nfloat64 x\nfloat64 y\n"
)
BOX_3D = (
    f"{DIVIDER}\nMSG: vision_msgs/BoundingBox3D\ngeometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)
# message type -> its text
TYPES: dict[str, str] = {
    "apriltag_msgs/msg/AprilTagDetectionArray": HEADER + "apriltag_msgs/AprilTagDetection[] detections\n" + TAG,
    "ros2_aruco_interfaces/msg/ArucoMarkers": HEADER + "int64[] marker_ids\ngeometry_msgs/Pose[] poses\n" + POSE,
}
# types that changed often -> their texts, the newest first: a message has to be as long as its text says
LAID_OUT: dict[str, tuple[str, ...]] = {
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray": (
        HEADER + "isaac_ros_apriltag_interfaces/AprilTagDetection[] detections\n" + ISAAC,
    ),
    "aruco_opencv_msgs/msg/ArucoDetection": (
        f"{HEADER}aruco_opencv_msgs/MarkerPose[] markers\naruco_opencv_msgs/BoardPose[] boards\n{BOARDS}",
    ),
    "aruco_msgs/msg/MarkerArray": (MARKERS + MARKER, MARKERS + CORNERS + MARKER),
    **{
        f"vision_msgs/msg/Detection{d}DArray": (
            f"{HEADER}vision_msgs/Detection{d}D[] detections\n{DIVIDER}\nMSG: vision_msgs/Detection{d}D\n"
            f"{HEADER}vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox{d}D bbox\n"
            f"string id\n{box}{HYPOTHESES}",
        )
        for d, box in ((2, BOX_2D), (3, BOX_3D))
    },
}
