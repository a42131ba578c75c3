"""A real Slurm of two nodes on this machine, for tests: its daemons are started by hand, and end with the tests.

It has no accounting database, and keeps no memory limit.
"""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

NODES = ("n1", "n2")
CPUS = 2
START_S = 40
# Debian has daemons where only root looks for programs.
PATH = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
DAEMONS = ("munged", "slurmctld", "slurmd")
CLIENTS = ("sbatch", "squeue", "scancel", "scontrol")
CONFIG = """\
ClusterName=tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
SlurmdTimeout=5
SlurmctldTimeout=5
MessageTimeout=5
KillWait=2
MinJobAge={min_job_age_s}
EnforcePartLimits=ALL
InactiveLimit=0
PreemptType=preempt/partition_prio
PreemptMode=CANCEL
SchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=0
{nodes}
PartitionName=work Nodes={names} Default=YES MaxTime=INFINITE State=UP PriorityTier=1
PartitionName=urgent Nodes={names} MaxTime=INFINITE State=UP PriorityTier=10
PartitionName=short Nodes={names} MaxTime=5 State=UP PriorityTier=1
"""


def missing_program() -> str | None:
    """Return a program of Slurm that this machine lacks, or why they cannot be started; None if all is there."""
    for name in (*DAEMONS, *CLIENTS):
        if shutil.which(name, path=PATH) is None:
            return f"{name} is not installed (Debian: slurmctld slurmd slurm-client munge)"
    return None if os.getuid() == 0 else "slurmd is started by root only, and this is another user"


@dataclass
class Cluster:
    """The daemons.

    Attributes:
        folder: their configuration, logs and sockets.
        environment: variables with which Slurm's commands find it.
        ports: port of each daemon.
    """

    folder: Path
    ports: dict[str, int]
    environment: dict[str, str] = field(default_factory=dict)
    _running: dict[str, "subprocess.Popen[bytes]"] = field(default_factory=dict)

    @property
    def config(self) -> Path:
        """The file `slurm.conf`."""
        return self.folder / "slurm.conf"

    def start(self, name: str) -> None:
        """Start `slurmctld`, or the daemon of a node."""
        daemon = ["slurmctld", "-D"] if name == "slurmctld" else ["slurmd", "-D", "-N", name]
        program = shutil.which(daemon[0], path=PATH)
        with (self.folder / f"{name}.out").open("ab") as out:
            self._running[name] = subprocess.Popen(
                [str(program), "-f", str(self.config), *daemon[1:]],
                stdout=out,
                stderr=out,
                stdin=subprocess.DEVNULL,
            )

    def stop(self, name: str, signum: signal.Signals = signal.SIGTERM) -> None:
        """End a daemon; the jobs of a node go on."""
        process = self._running.pop(name)
        process.send_signal(signum)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def ask(self, *command: str) -> str:
        """Return what a command of Slurm prints."""
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, **self.environment}
        )
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout.strip()

    def forget_jobs(self) -> None:
        """Have the controller forget all jobs, as it does a while after they ended."""
        self.stop("slurmctld")
        for path in (self.folder / "state").iterdir():
            if path.name.startswith(("job_state", "hash.")):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        self.start("slurmctld")
        self.wait_until_idle()

    def is_up(self) -> bool:
        """Return whether the controller answers and both nodes take jobs."""
        done = subprocess.run(
            ["sinfo", "--noheader", "--Node", "--partition=work", "--format=%T"],
            capture_output=True, text=True, check=False, env={**os.environ, **self.environment},
        )  # fmt: skip
        return done.returncode == 0 and done.stdout.split() == ["idle"] * len(NODES)

    def wait_until_idle(self, timeout_s: float = START_S) -> None:
        """Wait until no job is left, and all nodes are up."""
        deadline = time.monotonic() + timeout_s
        while not self.is_up():
            assert time.monotonic() < deadline, self.ask("scontrol", "show", "node") + self._logs()
            time.sleep(0.1)

    def reset(self) -> None:
        """Cancel all jobs, start what was stopped, and wait until all is idle."""
        for name in ("slurmctld", *NODES):
            if name not in self._running:
                self.start(name)
        subprocess.run(
            ["scancel", "--signal=KILL", "--batch", "--me"],
            check=False,
            capture_output=True,
            env={**os.environ, **self.environment},
        )
        subprocess.run(
            ["scancel", "--me"], check=False, capture_output=True, env={**os.environ, **self.environment}
        )
        self.wait_until_idle()

    def stop_all(self) -> None:
        """End all daemons."""
        for name in list(self._running)[::-1]:
            self.stop(name)

    def _logs(self) -> str:
        return "".join(f"\n--- {log.name}\n{log.read_text()[-2000:]}" for log in self.folder.glob("*.log"))


@contextmanager
def running_cluster(*, min_job_age_s: int = 300) -> Iterator[Cluster]:
    """Run a Slurm of two nodes; skip the test where it is not installed."""
    missing = missing_program()
    if missing is not None:
        pytest.skip(missing)
    with ExitStack() as stack:
        # A short path, for sockets; the munge daemon looks at who may write there.
        folder = Path(tempfile.mkdtemp(prefix="bagassets-slurm-", dir="/tmp"))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        folder.chmod(0o755)
        cluster = Cluster(folder, {name: free_port() for name in ("slurmctld", *NODES)})
        cluster.environment = {"SLURM_CONF": str(cluster.config), "PATH": PATH}
        (folder / "state").mkdir()
        for name in NODES:
            (folder / f"spool-{name}").mkdir()
        host = socket.gethostname()
        nodes = "\n".join(
            f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={cluster.ports[name]} "
            f"CPUs={CPUS} RealMemory=4000 State=UNKNOWN"
            for name in NODES
        )
        cluster.config.write_text(
            CONFIG.format(
                host=host,
                port=cluster.ports["slurmctld"],
                user=pwd.getpwuid(os.getuid()).pw_name,
                folder=folder,
                nodes=nodes,
                names=",".join(NODES),
                min_job_age_s=min_job_age_s,
            )
        )
        stack.enter_context(_munge(folder))
        stack.callback(cluster.stop_all)
        for name in ("slurmctld", *NODES):
            cluster.start(name)
        stack.callback(_end_jobs, cluster)
        cluster.wait_until_idle()
        yield cluster


@contextmanager
def _munge(folder: Path) -> Iterator[None]:
    """Run a munge daemon with a key of its own."""
    owner = pwd.getpwnam("munge")
    own = folder / "munge"
    own.mkdir(mode=0o700)
    key = own / "key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o600)
    for path in (own, key):
        os.chown(path, owner.pw_uid, owner.pw_gid)
    command = [
        *("munged", "--foreground", "--force", f"--key-file={key}", f"--socket={folder}/munge.socket"),
        *(f"--pid-file={own}/pid", f"--log-file={own}/log", f"--seed-file={own}/seed"),
    ]
    os.chown(folder, owner.pw_uid, owner.pw_gid)  # of its socket
    process = subprocess.Popen(
        [str(shutil.which(command[0], path=PATH)), *command[1:]],
        user="munge", group="munge", extra_groups=[], stdin=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + START_S
        while not (folder / "munge.socket").exists():
            assert process.poll() is None
            assert time.monotonic() < deadline, "munged did not start"
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait()


def _end_jobs(cluster: Cluster) -> None:
    subprocess.run(
        ["scancel", "--signal=KILL", "--full", "--me"],
        check=False,
        capture_output=True,
        env={**os.environ, **cluster.environment},
    )
    subprocess.run(
        ["scancel", "--me"], check=False, capture_output=True, env={**os.environ, **cluster.environment}
    )
    time.sleep(0.5)


def free_port() -> int:
    """Return a port that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
