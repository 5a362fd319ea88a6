"""Parts that many message types share, as text."""

from __future__ import annotations

HEADER = "std_msgs/Header header\n"
DIVIDER = "=" * 80
POSE = (
    f"{DIVIDER}\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
COVARIANCE = f"{DIVIDER}\nMSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
TWIST = (
    f"{DIVIDER}\nMSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)
PARTS = (
    f"{DIVIDER}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{DIVIDER}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
