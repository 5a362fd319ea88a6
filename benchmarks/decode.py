"""Read and decode a whole log, as one process: python -m benchmarks.decode stock|rosbags|ours LOG.

`stock` uses public packages: mcap, mcap-ros2-support, cv2.imdecode. `rosbags` uses the package rosbags. `ours`
reads the columns that locfuse reads.
"""

import sys
from pathlib import Path


def stock(path: Path) -> str:
    import cv2
    import numpy as np
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    pictures = 0
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, _, _, message in reader.iter_decoded_messages():
            if schema is not None and schema.name == "sensor_msgs/msg/CompressedImage":
                pictures += cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR) is not None
    return f"{pictures} pictures"


def rosbags(path: Path) -> str:
    from rosbags.highlevel import AnyReader

    count = 0
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            count += 1
    return f"{count} messages"


def ours(path: Path) -> str:
    from locfuse.formats.logs.log import open_log
    from locfuse.fusion.sensors.registry import REGISTRY
    from locfuse.fusion.truth import TRUTH_READS
    from locfuse.fusion.wheels.read import WHEEL_READS

    reads = {**TRUTH_READS, **WHEEL_READS}
    in_blocks = set()
    for sensor in REGISTRY.values():
        reads.update(sensor.reads)
        if getattr(sensor, "in_blocks", False):
            in_blocks |= set(sensor.reads)
    log = open_log([path])
    types = {name: topic.msgtype for name, topic in log.topics.items() if topic.msgtype in reads}
    wants = {name: () if kind in in_blocks else reads[kind] for name, kind in types.items()}
    rows = 0
    for name, stream in log.streams(wants).items():
        stream.columns(*wants[name])
        rows += len(stream.t_ns)
        if types[name] in in_blocks:
            for _ in stream.blocks(*reads[types[name]]):
                pass
    return f"{rows} messages"


if __name__ == "__main__":
    kinds = {"stock": stock, "rosbags": rosbags, "ours": ours}
    print(kinds[sys.argv[1]](Path(sys.argv[2])))
