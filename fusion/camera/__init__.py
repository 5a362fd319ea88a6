"""The omni-directional camera: from pictures to the bearing of a red vertical landmark. OpenCV lives here."""

COMPRESSED, RAW = ("data", "format"), ("data", "width", "height", "encoding", "step")
# message type -> the fields a picture is made of
FIELDS: dict[str, tuple[str, ...]] = {
    "sensor_msgs/msg/CompressedImage": COMPRESSED,
    "sensor_msgs/msg/Image": RAW,
    **dict.fromkeys(("foxglove.CompressedImage", "foxglove_msgs/msg/CompressedImage"), COMPRESSED),
    **dict.fromkeys(("foxglove.RawImage", "foxglove_msgs/msg/RawImage"), RAW),
}
