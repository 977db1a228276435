"""On which kind of file system a folder lies: SQLite's write-ahead log does not work over a network."""

from pathlib import Path

from softcal.core.errors import RegistryError

NETWORK_TYPES = frozenset(
    {
        "nfs",
        "nfs4",
        "cifs",
        "smb",
        "smb2",
        "smb3",
        "smbfs",
        "9p",
        "afs",
        "ceph",
        "glusterfs",
        "lustre",
        "gpfs",
        "beegfs",
    }
)
MOUNTS = Path("/proc/mounts")


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
