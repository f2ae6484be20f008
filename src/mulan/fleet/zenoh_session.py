"""Zenoh sessions of a base station and of robots, over plain TCP or mutual TLS."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import zenoh

from mulan.errors import InputError
from mulan.fleet.names import BASE
from mulan.fleet.verdict import GOODBYE, GREETING
from mulan.fleet.wire_topics import WIRE_TOPICS

LARGEST_ZENOH_MESSAGE_BYTES = 64 * 1024 * 1024
_WANTED = "all hear what the base wants"


@dataclass(frozen=True)
class LinkConfig:
    """Where the other side is and how it proves who it is."""

    endpoint: str = "tcp/127.0.0.1:7447"
    """Zenoh endpoint: the base station listens there, robots connect to it; tls/HOST:PORT with keys."""
    mode: Literal["router", "peer"] = "router"
    """What the base station is in the Zenoh network; a zenoh-bridge-ros2dds connects to a router."""
    keys: Path | None = None
    """Folder made by 'mulan fleet keys'; the base station and each robot need their own files of it."""


def open_base_session(link: LinkConfig, mission: str, robots: Sequence[str]) -> zenoh.Session:
    """The base station's session, listening.

    With keys, a client without a certificate of the folder's authority cannot connect, and each robot may
    write its own topics alone: the network enforces it, by the name in the certificate.

    Args:
        link: Options.
        mission: Name of the mission.
        robots: Who may write, if there are keys.

    Raises:
        InputError: The endpoint cannot be listened on, or the keys are not there.
    """
    options: dict[str, Any] = {
        "mode": link.mode,
        "listen/endpoints": [link.endpoint],
        "listen/exit_on_failure": True,
    }
    if link.keys is not None:
        if not robots:
            remedy = "give --ingest.robots, so that each may write its own topics alone"
            raise InputError("base station", "robots", "are not named but keys are given", remedy)
        options |= _tls(link, BASE)
        options["access_control"] = _access(mission, robots)
    return _open(link, options, "choose a free port and an address of this machine")


def open_robot_session(link: LinkConfig, robot: str) -> zenoh.Session:
    """A robot's session; it connects as soon as the base station is there, again and again.

    Raises:
        InputError: The endpoint is not one, or the keys are not there.
    """
    options = _connecting(link.endpoint)
    if link.keys is not None:
        options |= _tls(link, robot)
    return _open(link, options, "name the base station's address, such as tcp/192.168.1.10:7447")


def open_bridge_session(endpoint: str) -> zenoh.Session:
    """A session with a zenoh-bridge-ros2dds; it connects as soon as the bridge is there, again and again.

    Raises:
        InputError: The endpoint is not one.
    """
    remedy = "name the address the bridge listens at, such as tcp/127.0.0.1:7447"
    return _open(LinkConfig(endpoint), _connecting(endpoint), remedy)


def _connecting(endpoint: str) -> dict[str, Any]:
    return {
        # not "client", which waits for the other side before it opens
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2},
    }


def _open(link: LinkConfig, options: Mapping[str, Any], remedy: str) -> zenoh.Session:
    everywhere = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": LARGEST_ZENOH_MESSAGE_BYTES,
        "adminspace/enabled": False,
    }
    config = zenoh.Config()
    try:
        for name, value in {**everywhere, **options}.items():
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise InputError("link", f"endpoint '{link.endpoint}'", _first_line(error), remedy) from error


def _tls(link: LinkConfig, who: str) -> dict[str, Any]:
    assert link.keys is not None
    if not link.endpoint.startswith(("tls/", "quic/")):
        remedy = "write tls/ instead of tcp/, or leave the keys out"
        raise InputError("link", f"endpoint '{link.endpoint}'", "does not use keys", remedy)
    authority, certificate, key = (
        link.keys / "authority.pem",
        link.keys / f"{who}.pem",
        link.keys / f"{who}.key",
    )
    for path in (authority, certificate, key):
        if not path.is_file():
            raise InputError(path, "file", "does not exist", "make it with 'mulan fleet keys'")
    return {
        "transport/link/tls": {
            "root_ca_certificate": str(authority.resolve()),
            "listen_certificate": str(certificate.resolve()),
            "listen_private_key": str(key.resolve()),
            "connect_certificate": str(certificate.resolve()),
            "connect_private_key": str(key.resolve()),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
    }


def _access(mission: str, robots: Sequence[str]) -> dict[str, Any]:
    """Zenoh's access control: a robot may put its own topics and listen to the answers meant for it."""
    suffixes = [*WIRE_TOPICS, GREETING, GOODBYE]
    rules, subjects, policies = [], [], []
    for robot in robots:
        rules.append(
            {
                "id": f"{robot} writes",
                "permission": "allow",
                "flows": ["ingress"],
                "messages": ["put"],
                "key_exprs": [f"mulan/{mission}/{robot}/{suffix}" for suffix in suffixes],
            }
        )
        rules.append(
            {
                "id": f"{robot} listens",
                "permission": "allow",
                "flows": ["ingress"],
                "messages": ["declare_subscriber"],
                "key_exprs": [f"mulan/{mission}/{BASE}/{robot}/**"],
            }
        )
        rules.append(
            {
                "id": f"{robot} is answered",
                "permission": "allow",
                "flows": ["egress"],
                "messages": ["put"],
                "key_exprs": [f"mulan/{mission}/{BASE}/{robot}/**"],
            }
        )
        subjects.append({"id": robot, "cert_common_names": [robot]})
        names = [f"{robot} writes", f"{robot} listens", f"{robot} is answered", _WANTED]
        policies.append({"rules": names, "subjects": [robot]})
    # the base's own subscription must reach clients, or they would not send
    rules.append(
        {
            "id": _WANTED,
            "permission": "allow",
            "flows": ["egress"],
            "messages": ["declare_subscriber"],
            "key_exprs": [f"mulan/{mission}/**"],
        }
    )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0][:200]
