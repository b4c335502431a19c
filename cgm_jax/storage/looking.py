"""What lies at a path that the user names, where not even a look at it may be possible."""

import os
import stat
from pathlib import Path

from cgm_jax.config.fields import SettingError


def look_at(setting: str, path: Path) -> os.stat_result | None:
    """What the system says of a path; None if nothing lies there.

    Args:
        setting: the option that names it.
        path: what it names.

    Raises:
        SettingError: it says nothing, since the path leads through somebody's private folder, or a
            name is too long.
    """
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise SettingError(f"{setting}: cannot look at {path}: {error.strerror}") from None


def is_directory(setting: str, path: Path) -> bool:
    """Whether a directory lies at a path, or where a link there leads; see `look_at`."""
    found = look_at(setting, path)
    return found is not None and stat.S_ISDIR(found.st_mode)


def check_place(setting: str, path: Path) -> None:
    """Check that a directory lies at a path, or that nothing there is in the way of one.

    Where no look is possible just now, whoever makes the directory says why.

    Raises:
        SettingError: something else lies there, or where it would have to lie.
    """
    for place in (path, *path.parents):
        try:
            found = place.stat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError:
            return
        if not stat.S_ISDIR(found.st_mode):
            raise SettingError(f"{setting}: {place} is no directory")
        return


def is_ordinary_file(setting: str, path: Path) -> bool:
    """Whether an ordinary file does; see `look_at`."""
    found = look_at(setting, path)
    return found is not None and stat.S_ISREG(found.st_mode)


def is_there(setting: str, path: Path) -> bool:
    """Whether anything does; see `look_at`."""
    return look_at(setting, path) is not None
