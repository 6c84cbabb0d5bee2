"""The default training, whole: it calms the wake, and the wake stays calm."""

from manywake.flow import case
from manywake.learn import evaluate, runs
from manywake.learn.engine import Threads
from manywake.learn.settings import PROTOCOLS, Settings


def test_default_training_removes_seven_per_cent_of_the_drag_and_holds(tmp_path):
    task, learning = PROTOCOLS["default"]
    settings = Settings(case.by_name("cylinder-jets"), task, learning, seed=0)
    engine = Threads(2)
    runs.train(tmp_path / "run", settings, engine)
    result = evaluate.evaluate(settings.case, task, runs.Run(tmp_path / "run").policy(), engine)
    engine.close()
    for control in (result.episode, result.long_run, *result.phases):
        assert 0.07 <= control.drag_reduction <= 0.0795
        assert abs(control.cl_mean) <= 0.15
