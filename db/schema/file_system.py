"""The file of an SQLite registry, whose write-ahead log works over no network."""

import os
from pathlib import Path

from softcal.core.errors import RegistryError

NETWORK_TYPES = frozenset("nfs nfs4 cifs smb smb2 smb3 smbfs 9p afs ceph glusterfs lustre gpfs beegfs".split())
MOUNTS = Path("/proc/mounts")


def prepare_file(path: Path, create: bool) -> None:
    """Make the file of a registry unless it is there (`RegistryError`: it cannot be used)."""
    folder = path.absolute().parent
    if not folder.is_dir():
        raise RegistryError(f"registry {path}: the folder {folder} does not exist; make it or give another URL")
    if path.is_dir():
        raise RegistryError(f"registry {path} is a folder; a file was expected")
    if not create and not path.exists():
        raise RegistryError(f"registry {path}: there is no such file; `softcal batch` or `softcal demo` makes one")
    if not os.access(path if path.exists() else folder, os.W_OK) or not os.access(folder, os.W_OK):
        raise RegistryError(f"registry {path}: {folder} cannot be written; SQLite needs the folder, too")
    refuse_network_share(folder)
    if not path.exists():
        # It holds hashes of PINs: for its owner alone. SQLite gives its log the same mode.
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        except FileExistsError:
            pass
        except OSError as error:
            raise RegistryError(f"registry {path}: cannot be written: {error.strerror}") from error


def refuse_network_share(folder: Path, mounts: Path = MOUNTS) -> None:
    """Raise `RegistryError` where `folder` is on a network share (Linux mounts, UNC paths)."""
    inside, best, kind = folder.resolve(), Path("/"), ""
    for line in mounts.read_text(errors="replace").splitlines() if mounts.is_file() else ():
        match line.split():
            case [_, point, of_type, *_]:
                mounted = Path(point.replace("\\040", " "))
                if inside.is_relative_to(mounted) and len(mounted.parts) >= len(best.parts):
                    best, kind = mounted, of_type
    if str(folder).startswith(("\\\\", "//")):
        kind = "a UNC path"
    elif kind not in NETWORK_TYPES and not kind.startswith(("fuse.sshfs", "fuse.rclone", "fuse.gluster", "fuse.ceph")):
        kind = ""
    if kind:
        raise RegistryError(
            f"registry folder {folder} is on a network share ({kind}); SQLite loses data there, because its "
            "write-ahead log needs shared memory of one machine; use a local folder, or postgresql:// for many stations"
        )
