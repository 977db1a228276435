"""The file of an SQLite registry: whether it may lie where it shall. Its write-ahead log works over no network."""

import os
from pathlib import Path

from softcal.core.errors import RegistryError

NETWORK_TYPES = frozenset("nfs nfs4 cifs smb smb2 smb3 smbfs 9p afs ceph glusterfs lustre gpfs beegfs".split())
MOUNTS = Path("/proc/mounts")


def prepare_file(path: Path, create: bool) -> None:
    """Make the file of a registry, unless it is there, and raise `RegistryError` where it cannot be used."""
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
        # There are hashes of PINs in it: nobody else may read it. SQLite gives its log the same mode.
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        except FileExistsError:
            pass
        except OSError as error:
            raise RegistryError(f"registry {path}: cannot be written: {error.strerror}") from error


def refuse_network_share(folder: Path, mounts: Path = MOUNTS) -> None:
    """Raise `RegistryError` where `folder` lies on a network share (Linux mount table, or a Windows UNC path)."""
    if str(folder).startswith(("\\\\", "//")):
        kind: str | None = "a UNC path"
    else:
        kind = _network_type(folder.resolve(), mounts)
    if kind is not None:
        raise RegistryError(
            f"registry folder {folder} is on a network share ({kind}); SQLite loses data there, because its "
            "write-ahead log needs shared memory of one machine; use a local folder, or postgresql:// for many stations"
        )


def _network_type(folder: Path, mounts: Path) -> str | None:
    if not mounts.is_file():
        return None
    best, kind = Path("/"), ""
    for line in mounts.read_text(errors="replace").splitlines():
        fields = line.split()
        if len(fields) < 3:
            continue
        point = Path(fields[1].replace("\\040", " "))
        if folder.is_relative_to(point) and len(point.parts) >= len(best.parts):
            best, kind = point, fields[2]
    is_network = kind in NETWORK_TYPES or kind.startswith(("fuse.sshfs", "fuse.rclone", "fuse.gluster", "fuse.ceph"))
    return kind if is_network else None
