"""Ray: the same episodes on a cluster, of which a node may vanish."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
import ray
from ray.cluster_utils import Cluster

from manywake.case.learning import Learning
from manywake.learn import flows, ppo, schedule
from manywake.learn.blocks import Layout
from manywake.learn.engine import TimedOut, WorkerDied
from manywake.learn.ray_engine import Ray
from manywake.learn.settings import Collection
from manywake.suite import load

from .external import case_file
from .test_engine import bad, die, hang
from .test_runs import there_and_here
from .toy import Toy, collector

pytestmark = [
    pytest.mark.alone,
    pytest.mark.filterwarnings("ignore"),  # of Ray's own threads and sockets, at shutdown
]
LEARNING = Learning(
    update_period=8, episodes=24, learner_threads=1, learning_rate=3e-3, batch_size=40, n_epochs=1, hidden=(8,)
)
HORIZON = 5


def digest(toy=Toy(horizon=HORIZON), **changes) -> str:  # noqa: B008
    model = ppo.build(LEARNING, collector(toy, learning=LEARNING, **changes))
    model.learn(LEARNING.episodes * HORIZON)
    return ppo.digest(model)


@pytest.fixture(scope="module")
def cluster():
    """Three nodes on this machine: the head, without cores, and two with two cores each, whatever the home holds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")
        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
        nodes = [made.add_node(num_cpus=2) for _ in range(2)]
        made.wait_for_nodes()
        engine = Ray(8, address=made.address)
        yield made, nodes, engine
        engine.close()
        made.shutdown()


@pytest.fixture(scope="module")
def engine(cluster):
    return cluster[2]


def test_a_future_tells_exception_death_and_time_out_apart(engine):
    assert engine.slots == 4  # not eight: the cluster has four cores
    assert engine.submit(max, 3, 4).result(60) == 4
    with pytest.raises(ArithmeticError, match="7 is bad"):
        engine.submit(bad, 7).result(60)
    with pytest.raises(WorkerDied, match="WorkerCrashedError"):
        engine.submit(die, signal.SIGKILL).result(60)
    with pytest.raises(TimedOut, match="no result within"):
        engine.submit(hang, timeout=1.0).result(60)
    assert engine.submit(dict.__getitem__, engine.share({"a": 1.5}), "a").result(60) == 1.5


def test_training_on_a_cluster_gives_the_bits_of_a_serial_one(engine):
    assert digest(engine=engine, grid=Layout(8, 4, 2)) == digest()


def test_a_users_reward_reaches_a_machine_where_its_file_is_not(tmp_path, engine):
    file = case_file(tmp_path)
    simulation = flows.open_flows(load.choose(file))
    file.unlink()
    ours, theirs = there_and_here(simulation, engine)
    assert theirs == ours


def test_several_variants_on_a_cluster_give_the_bits_of_a_serial_training(engine):
    toy = Toy(horizon=HORIZON, variants=3)
    assert digest(toy, engine=engine, grid=Layout(8, 4, 2)) == digest(toy)


@pytest.mark.parametrize("fault", ["raise", "kill"])
def test_a_fault_costs_no_bit(tmp_path, engine, fault):
    toy = Toy(horizon=HORIZON, faults=((3, fault), (17, fault)), folder=tmp_path)
    lost = []
    assert digest(toy, engine=engine, grid=Layout(8, 4, 2), failed=lost.append) == digest()
    assert len(lost) == 2


@dataclass(frozen=True)
class Gated(Toy):
    """From the twelfth episode on, a block says that it has begun, and waits for the gate to open."""

    def play(self, driving, contexts):
        if contexts[0].index >= 12:
            (self.folder / f"begun-{contexts[0].index}").touch()
            while not (self.folder / "open").exists():
                time.sleep(0.02)
        return super().play(driving, contexts)


def test_a_node_that_vanishes_in_mid_training_costs_no_bit(cluster, tmp_path):
    made, nodes, engine = cluster
    toy = Gated(horizon=HORIZON, folder=tmp_path)
    plan = schedule.unsynced(schedule.durations(0, LEARNING.episodes, 5.0, 0.05), 12, 8, 0.3)
    reference = digest(grid=Layout(12, 1, 12), plan=plan)
    lost = []

    def remove():
        while len(list(tmp_path.glob("begun-*"))) < 4:  # every core of both nodes plays
            time.sleep(0.02)
        # a real end: the node's processes are killed while its workers play
        made.remove_node(nodes[0], allow_graceful=False)
        (tmp_path / "open").touch()

    remover = threading.Thread(target=remove, daemon=True)
    remover.start()
    found = digest(toy, engine=engine, grid=Layout(12, 4, 2), plan=plan, failed=lost.append)
    remover.join()
    assert found == reference
    assert lost and all(failure.kind == "died" for failure in lost)
    for _ in range(300):  # Ray tells of the loss by and by
        if engine.slots == 2:
            break
        time.sleep(0.1)
    assert engine.slots == 2


def test_time_in_the_queue_is_not_the_tasks(engine):
    futures = [engine.submit(time.sleep, 0.6, timeout=1.5) for _ in range(16)]
    for future in futures:
        assert future.result(60) is None  # the last of them waited for longer than it may take


def test_an_address_is_refused_without_ray():
    with pytest.raises(ValueError, match="address: .* with engine processes, wanted it with --engine ray"):
        Collection(address="auto")


def test_ray_of_our_own_gives_the_same_bits_and_listens_on_loopback_only():
    done = subprocess.run([sys.executable, "-m", "tests.test_ray"], capture_output=True, text=True, check=True)
    found, addresses, left = done.stdout.splitlines()
    assert found == digest()
    loopback = {"0100007F", "0000000000000000FFFF00000100007F"}  # 127.0.0.1, and the same as an IPv6 address
    assert addresses and set(addresses.split()) <= loopback
    assert left == "False"


def listening() -> set[str]:
    """Return the addresses that this process and its descendants listen on, as /proc has them."""
    parents, inodes = {}, set()
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            try:
                parents[int(process.name)] = int((process / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
    for process in parents:
        line = [process]
        while line[-1] in parents:
            line.append(parents[line[-1]])
        if os.getpid() in line:
            for link in Path(f"/proc/{process}/fd").iterdir():
                try:
                    inodes.add(os.readlink(link))
                except OSError:
                    continue
    rows = [
        line.split() for table in ("tcp", "tcp6") for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
    ]
    return {row[1].split(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in inodes}


if __name__ == "__main__":
    mine = Ray(2)
    print(digest(engine=mine, grid=Layout(8, 2, 4)))
    print(*listening())
    mine.close()
    print(ray.is_initialized())
