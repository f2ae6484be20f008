"""The page: the field behind, the mission in it, the controls beside."""

import threading

import numpy as np
from viser import ClientHandle, ViserServer

from mulan.errors import InputError
from mulan.geometry.alignment import point_nearest_to_axes
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.camera_paths import orbit
from mulan.report.run_contents import RunContents, read_run
from mulan.viewer.candidate_layers import CandidateLayers
from mulan.viewer.client_pictures import ClientCamera, ClientPictures
from mulan.viewer.engine_access import EngineAccess, TrainingEngine
from mulan.viewer.frame import Quantity
from mulan.viewer.goal_controls import GoalControls
from mulan.viewer.goals import GoalSink
from mulan.viewer.lighting import light_cheaply
from mulan.viewer.mission_layers import MissionLayers
from mulan.viewer.opening_picture import OpeningPicture
from mulan.viewer.panel import LayerControls, PictureControls, TrainingControls, add_figures, add_radio
from mulan.viewer.photograph_layers import PhotographLayers
from mulan.viewer.viewer_config import ViewerConfig

_FRUSTUM_SHARE = 0.05  # of the distance to what the photographs look at
_WINDOW = 1280, 720  # of a visitor who has not come yet
_OPENING_PERIOD_S = 10.0  # between opening pictures of a field that learns: one percent of its time


class ViewerPage:
    """A served page; close it with :meth:`stop`.

    Attributes:
        url: Where to open it on this machine.
        pictures: What each connected browser is shown, by its number.
    """

    def __init__(
        self,
        run: RunFolder,
        engine: EngineAccess,
        goals: GoalSink,
        config: ViewerConfig,
        contents: RunContents | None = None,
    ) -> None:
        """Serve a run.

        Args:
            run: The folder; ``transforms.json`` must be there, the rest is shown where it is.
            engine: The field.
            goals: Where views picked by hand go.
            config: Address and pictures.
            contents: What to show around the field, where not the run's own: an evaluation keeps the
                localization above its setups.

        Raises:
            InputError: The run has no photographs, or the address cannot be served.
        """
        self._config, self._engine, self._run = config, engine, run
        images, contents = _read_images(run), contents or read_run(run)
        self._server = _new_server(self._config)
        light_cheaply(self._server.scene)
        self.pictures: dict[int, ClientPictures] = {}
        self._quantity: Quantity = "colour"
        self._lock, self._layers_shown = threading.RLock(), False
        first_view = self._place_first_camera(images)
        self._opening = OpeningPicture(
            lambda picture: self._server.scene.set_background_image(
                picture, "jpeg", jpeg_quality=config.picture.jpeg_quality
            ),
            engine,
            first_view,
            config.picture.moving_side,
            lambda: bool(self.pictures),
            _OPENING_PERIOD_S if self._still_learns else None,
        )
        self._build(images, contents, goals)
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._farewell)

    @property
    def url(self) -> str:
        """On this machine."""
        host = "localhost" if self._config.host in ("0.0.0.0", "::") else self._config.host
        return f"http://{host}:{self._server.get_port()}"

    def stop(self) -> None:
        """Close all."""
        self._opening.stop()
        for pictures in list(self.pictures.values()):
            pictures.stop()
        self._server.stop()

    def redraw(self) -> None:
        """The field has changed."""
        self._opening.redraw()
        for pictures in list(self.pictures.values()):
            pictures.redraw()

    def show_plan(self) -> None:
        """Read plan.json again."""
        contents = read_run(self._run)
        if contents.plan is not None:
            with self._lock:
                self._candidates = CandidateLayers(self._server.scene, contents.plan, self._scale_m)
                self._show_layers()

    def show_mission(self) -> None:
        """Read photographs, poses and covariances again: another process goes on localizing."""
        images, contents = _read_images(self._run), read_run(self._run)
        with self._lock, self._server.atomic():
            if contents.localization:
                self._mission = MissionLayers(self._server.scene, contents.localization)
            self._photographs.remove()
            self._photographs = PhotographLayers(self._server, images, self._scale_m)
        if self._mission is not None:
            self._layer_controls.lengthen(self._mission.span_s)
        self._show_layers()

    def refresh(self) -> None:
        """Bring the words beside the picture up to date; called now and then."""
        last = next((p for p in self.pictures.values() if p.last is not None), None)
        if last is not None and last.last is not None:
            speed = f"{1 / max(last.seconds_a_frame, 1e-3):.0f} pictures/s"
            self._picture_controls.say(f"{last.last.legend}  \n{speed}" if last.last.legend else speed)
        if self._training_controls is not None:
            self._training_controls.refresh()

    def training_ended(self) -> None:
        """The buttons have nothing left to do."""
        if self._training_controls is not None:
            self._training_controls.end()
        self.redraw()

    @property
    def _still_learns(self) -> bool:
        return isinstance(self._engine, TrainingEngine)

    def _place_first_camera(self, images: PosedImageSet) -> ClientCamera:
        T = np.stack([image.T_world_camera for image in images.train])
        centre_m = point_nearest_to_axes(T[:, :3, 3], -T[:, :3, 2])
        _, first = orbit(images, 1)[0]
        distance_m = float(np.linalg.norm(first[:3, 3] - centre_m))
        self._scale_m = _FRUSTUM_SHARE * distance_m
        camera = self._server.initial_camera
        camera.position, camera.look_at = tuple(first[:3, 3]), tuple(centre_m)
        return ClientCamera(first, camera.fov, *_WINDOW)

    def _build(self, images: PosedImageSet, contents: RunContents, goals: GoalSink) -> None:
        server = self._server
        server.scene.set_up_direction("+z")
        mission = MissionLayers(server.scene, contents.localization) if contents.localization else None
        self._mission, self._photographs = mission, PhotographLayers(server, images, self._scale_m)
        self._candidates = (
            CandidateLayers(server.scene, contents.plan, self._scale_m) if contents.plan else None
        )

        server.gui.configure_theme(dark_mode=False, show_logo=False)
        self._picture_controls = PictureControls(server.gui, self._show_quantity)
        self._training_controls = (
            TrainingControls(server.gui, self._engine) if isinstance(self._engine, TrainingEngine) else None
        )
        self._layer_controls = LayerControls(
            server.gui,
            mission.span_s if mission else None,
            mission is not None and any(robot.truth is not None for robot in mission.robots),
            mission.exaggeration if mission else 1,
            self._show_layers,
        )
        names = contents.robots or sorted({image.robot_id or "camera" for image in images.train})
        self._goal_controls = GoalControls(server, names, goals, self._scale_m)
        add_figures(server.gui, contents.headline_metrics, contents.history)
        if contents.localization:
            add_radio(server.gui, contents.localization)

    def _show_layers(self) -> None:
        """Draw what the boxes say, but not before somebody has his picture: it would wait for the layers."""
        choice, (photos, candidates) = self._layer_controls.choice(), self._layer_controls.further()
        with self._lock, self._server.atomic():
            if not self._layers_shown:
                return
            if self._mission is not None:
                self._mission.show(choice)
            self._photographs.show(photos, choice.until_s)
            if self._candidates is not None:
                self._candidates.show(candidates)

    def _complete_scene(self) -> None:
        with self._lock:
            if not self._layers_shown:
                self._layers_shown = True
                self._show_layers()

    def _clear_scene(self) -> None:
        with self._lock, self._server.atomic():
            self._layers_shown = False
            if self._mission is not None:
                self._mission.remove()
            self._photographs.remove()
            if self._candidates is not None:
                self._candidates.show(False)

    def _show_quantity(self, quantity: Quantity) -> None:
        self._quantity = quantity
        for pictures in list(self.pictures.values()):
            pictures.quantity = quantity
        self.redraw()

    def _welcome(self, client: ClientHandle) -> None:
        pictures = ClientPictures(
            client, self._engine, self._config.picture, self._still_learns, self._complete_scene
        )
        pictures.quantity = self._quantity
        self.pictures[client.client_id] = pictures

    def _farewell(self, client: ClientHandle) -> None:
        pictures = self.pictures.pop(client.client_id, None)
        if pictures is not None:
            pictures.stop()
        if not self.pictures:
            self._clear_scene()
            self._opening.redraw()


def _read_images(run: RunFolder) -> PosedImageSet:
    images = read_transforms(run.transforms)
    if not images.train:
        raise InputError(run.transforms, "frames", "no training image", "add photographs and poses")
    return images


def _new_server(config: ViewerConfig) -> ViserServer:
    try:
        return ViserServer(host=config.host, port=config.port, label="MULAN", verbose=False)
    except OSError as error:
        remedy = "give another --viewer.host or --viewer.port"
        raise InputError(f"{config.host}:{config.port}", "address", str(error), remedy) from error
