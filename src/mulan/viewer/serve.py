"""A page beside a training, in the same process, open as long as the training runs."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.trainer import TrainingStatus
from mulan.viewer.engine_access import TrainingEngine
from mulan.viewer.goals import GoalFile
from mulan.viewer.page import ViewerPage
from mulan.viewer.viewer_config import ViewerConfig

_REFRESH_S = 0.5


@contextmanager
def page_of_training(
    run: RunFolder, config: ViewerConfig, say: Callable[[str], None] = print
) -> Iterator[Callable[[TrainingStatus], None]]:
    """Serve a page; what is yielded must be called after every step of the training.

    Args:
        run: Folder with ``transforms.json``.
        config: Address and pictures.
        say: Told where the page is.

    Raises:
        InputError: See :class:`mulan.viewer.page.ViewerPage`.
    """
    engine = TrainingEngine()
    page = ViewerPage(run, engine, GoalFile(run.root / "goals.json"), config)
    say(f"Page: {page.url}")
    over = threading.Event()

    def keep_words_up_to_date() -> None:
        while not over.wait(_REFRESH_S):
            page.refresh()

    threading.Thread(target=keep_words_up_to_date, name="page words", daemon=True).start()
    try:
        yield engine.after_step
    finally:
        over.set()
        engine.end()
        page.training_ended()
        page.stop()
