"""The part of the panel where a person sends a robot to the view now on the screen."""

from viser import GuiButtonHandle, GuiEvent, ViserServer

from mulan.errors import InputError
from mulan.report.charts import colour_of
from mulan.viewer.client_pictures import camera_of
from mulan.viewer.goals import GoalSink
from mulan.viewer.mission_layers import rgb
from mulan.viewer.photograph_layers import add_frustum

_GOAL_SCALE = 2.0


class GoalControls:
    """Choose a robot, look where it shall look, press the button."""

    def __init__(self, server: ViserServer, robots: list[str], goals: GoalSink, scale_m: float) -> None:
        with server.gui.add_folder("Send a robot"):
            robot = server.gui.add_dropdown("Robot", tuple(robots))
            button = server.gui.add_button("Take the view I see")
            said = server.gui.add_markdown("")

        @button.on_click
        def _(event: GuiEvent[GuiButtonHandle]) -> None:
            if event.client is None:
                return
            view, name = camera_of(event.client), str(robot.value)
            try:
                answer = goals.accept(name, view.T_world_camera)
            except InputError as error:
                said.content = str(error)
                return
            add_frustum(
                server.scene,
                f"/goals/{name}",
                view.camera(64),
                view.T_world_camera,
                rgb(colour_of(robots.index(name))),
                _GOAL_SCALE * scale_m,
            )
            x, y, z = view.T_world_camera[:3, 3]
            said.content = f"{name}: goal at ({x:.2f}, {y:.2f}, {z:.2f}) m {answer}"
