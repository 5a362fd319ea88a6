"""Omni-directional camera: pictures of the room in a hyperbolic mirror, as JPEG with noise and blur."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from .mirror import rays
from .render import Hits, Surface, VerticalFaces, View, shade
from .robot import SimulatedRobot
from .scenario import CameraSpec
from .world import World

DECK = (38.0, 38.0, 40.0)  # colour of the robot in the middle of the mirror
BLACK = (6.0, 6.0, 6.0)  # colour around the mirror
FLICKER_SHARE = 0.02  # relative standard deviation of the exposure from image to image


class OmniCamera:
    """Omni-directional camera sensor: takes pictures at the robot's true pose."""

    name, topic, msgtype = "camera", "/omni/image/compressed", "sensor_msgs/msg/CompressedImage"
    frame_id = "omni_camera"
    duration = 0.0

    def __init__(self, camera: CameraSpec, scene: World, robot: SimulatedRobot, rng: np.random.Generator) -> None:
        self.settings, self.scene, self.robot, self.rng = camera, scene, robot, rng
        self.period, self.phase, self.latency = 1 / camera.rate, camera.phase, camera.latency
        self.mount = np.array([camera.x, camera.y, np.radians(camera.yaw_deg)])
        self.painter = Painter(camera, scene)

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields of a JPEG picture taken at t [s]."""
        pose = self.robot.sensor_pose("camera", np.array([t]), self.mount)[0]
        image = expose(self.painter.paint(pose, t), self.settings, self.rng)
        quality = [cv2.IMWRITE_JPEG_QUALITY, self.settings.quality]
        _, jpeg = cv2.imencode(".jpg", image, quality)
        return {"format": "jpeg", "data": jpeg.tobytes()}


class Painter:
    """Renderer of pictures without lens and sensor errors."""

    def __init__(self, camera: CameraSpec, scene: World) -> None:
        self.camera, self.scene = camera, scene
        self.rays = rays(camera)
        self.view = View(self.rays)
        w, h = scene.room.size
        lamp = scene.room.height - 0.1
        self.lamps = np.array([(w / 4, h / 2, lamp), (3 * w / 4, h / 2, lamp)])
        self.background = self._background()

    def paint(self, pose: Array, t: float) -> NDArray[np.float32]:
        """Return the picture (height, width, 3), RGB, seen from the camera pose (3,) at t [s]."""
        eye = np.array([pose[0], pose[1], self.camera.z, pose[2]])
        seen = shade(self.trace(eye, t), eye, self.lamps)
        image = self.background.copy()
        image.reshape(-1, 3)[self.rays.pixel] = seen
        return image

    def trace(self, eye: Array, t: float) -> Hits:
        """Return the first hits of the pixels' rays from `eye` = (x, y, z, heading) at t [s]."""
        room, scene = self.scene.room, self.scene
        standing = [
            VerticalFaces(scene.walls, room.height, Surface.WALL),
            VerticalFaces(scene.plates, room.plate_height, Surface.PLATE),
        ]
        return self.view.trace(eye, standing, scene.pillars(t), room.height, scene.rings)

    def _background(self) -> NDArray[np.float32]:
        width, height = self.camera.size
        v, u = np.mgrid[:height, :width]
        radius = np.hypot(u - self.camera.centre[0], v - self.camera.centre[1])
        inside = (radius < self.camera.inner)[..., None]
        return np.where(inside, DECK, BLACK).astype(np.float32)


def expose(light: NDArray[np.float32], camera: CameraSpec, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture (height, width, 3), BGR, with exposure error, blur and noise."""
    gain = camera.brightness * (1 + FLICKER_SHARE * rng.standard_normal())
    image = np.multiply(cv2.cvtColor(light, cv2.COLOR_RGB2BGR), gain, dtype=np.float32)
    if camera.blur > 0:
        cv2.GaussianBlur(image, (0, 0), camera.blur, dst=image)
    image += np.float32(camera.noise) * rng.standard_normal(image.shape, np.float32)
    return np.asarray(np.clip(image, 0, 255), np.uint8)
