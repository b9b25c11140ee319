"""What a webhook is: an address that we may call, a secret, and a signature that its receiver can check.

Problem  An address that a client gives us is called from inside our network; what we send must be told from what others
         send, by a receiver that may get it late, twice, or not from us.
Method   Only https to addresses that are public by all that the host's name resolves to, decided at registration and again
         for every delivery, which then connects to an address that was decided on and asks no resolver a second time.
         Networks of the operator's choice are exempt, there http is allowed too.
         Signatures are those of Standard Webhooks: HMAC-SHA256 over "id.timestamp.body", so that receivers in any language
         can verify them with a library.
After    Standard Webhooks specification, 1.0 (standardwebhooks.com).
"""

import base64
import binascii
import hashlib
import hmac
import ipaddress
import re
import secrets
import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

from farfield.errors import SignatureInvalid, WebhookAddressRefused

PREFIX = "whsec_"
TOLERANCE_S = 300.0
MAX_URL = 2000

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network

_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")
_SPECIAL = ipaddress.IPv4Network("192.0.0.0/24")  # special purposes (RFC 6890): a cloud's metadata lies there


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An address in its parts, and what its host resolves to; all of it allowed."""

    secure: bool
    host: str  # as TLS and the Host header name it
    port: int
    target: str  # path and query
    addresses: tuple[str, ...]


def new_secret() -> str:
    """Return a new secret: 256 random bits."""
    return PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def sign(keys: Sequence[str], delivery: str, body: bytes, *, at: int) -> dict[str, str]:
    """Return the headers that say who sends `body`: one signature for each of the secrets `keys`.

    at  seconds since 1970 UTC
    """
    signatures = " ".join(f"v1,{_signature(key, delivery, at, body)}" for key in keys)
    return {"webhook-id": delivery, "webhook-timestamp": str(at), "webhook-signature": signatures}


def verify(secret: str, headers: Mapping[str, str], body: bytes, *, now: float | None = None) -> None:
    """Check that `body` was sent by who knows `secret`, in the last five minutes. Raises SignatureInvalid.

    headers  of the request, whatever their case; `now` is the receiver's clock (default: this machine's)
    """
    sent = {key.lower(): value for key, value in headers.items()}
    delivery, stamp = sent.get("webhook-id", ""), sent.get("webhook-timestamp", "")
    if not re.fullmatch("[0-9]{1,12}", stamp):
        raise SignatureInvalid("the request has no webhook-timestamp")
    if abs((time.time() if now is None else now) - int(stamp)) > TOLERANCE_S:
        raise SignatureInvalid("the request is too old, or from the future")
    wanted = _signature(secret, delivery, int(stamp), body)
    given = [part.removeprefix("v1,") for part in sent.get("webhook-signature", "").split() if part.startswith("v1,")]
    if not any(hmac.compare_digest(wanted.encode(), one.encode()) for one in given):
        raise SignatureInvalid("the request is not signed with this secret")


def resolve(url: str, allowed: Sequence[Network] = ()) -> Endpoint:
    """Return where `url` leads, resolved now. Raises WebhookAddressRefused, which never says what an inner name is.

    allowed  networks that count as public, and to which http is enough
    """
    secure, host, port, target = _parts(url)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, proto=socket.IPPROTO_TCP)
    except (OSError, UnicodeError):
        found = []  # the same answer as for a name of the inside: a stranger may not ask which there are
    addresses = tuple(dict.fromkeys(str(entry[4][0]) for entry in found))
    parsed = [ipaddress.ip_address(address) for address in addresses]
    ours = [any(a.version == n.version and a in n for n in allowed) for a in parsed]
    if not parsed or not all(inner or is_public(address) for inner, address in zip(ours, parsed, strict=True)):
        raise WebhookAddressRefused(f"{host:.255} does not resolve to public addresses")
    if not secure and not all(ours):
        raise WebhookAddressRefused("the address must begin with https://")
    return Endpoint(secure, host, port, target, addresses)


def is_public(address: Address) -> bool:
    """Say whether the address is one of the open Internet, and hides none that is not.

    May refuse an address that is harmless (a relay's, a documentation range), never allows one that is not public.
    """
    inner: list[ipaddress.IPv4Address] = []
    if isinstance(address, ipaddress.IPv6Address):
        if address.is_site_local:
            return False
        inner += [a for a in (address.ipv4_mapped, address.sixtofour, *(address.teredo or ())) if a is not None]
        if address in _NAT64 or int(address) < 1 << 32:
            inner.append(ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF))
    elif address in _SPECIAL:
        return False
    plain = not (address.is_multicast or address.is_reserved or address.is_unspecified) and address.is_global
    return (plain or address in _NAT64 if isinstance(address, ipaddress.IPv6Address) else plain) and all(
        map(is_public, inner)
    )


def networks(text: str) -> tuple[Network, ...]:
    """Return the networks in "10.1.0.0/16,fd00::/8". Raises ValueError."""
    return tuple(ipaddress.ip_network(part.strip()) for part in text.split(",") if part.strip())


def _parts(url: str) -> tuple[bool, str, int, str]:
    if len(url) > MAX_URL or not url.isascii() or re.search(r"[\x00-\x20\x7f\\\\]", url):
        raise WebhookAddressRefused("the address holds characters that it must not hold, or is too long")
    try:
        split = urlsplit(url)
        host, port = split.hostname or "", split.port
    except ValueError:
        raise WebhookAddressRefused("the address cannot be read") from None
    if split.scheme not in ("https", "http"):
        raise WebhookAddressRefused("the address must begin with https://")
    if not host or split.username is not None or split.password is not None or split.fragment or port == 0:
        raise WebhookAddressRefused("the address must be https://HOST/PATH, without a user or a fragment")
    target = (split.path or "/") + (f"?{split.query}" if split.query else "")
    return split.scheme == "https", host, port or (443 if split.scheme == "https" else 80), target


def _signature(secret: str, delivery: str, at: int, body: bytes) -> str:
    try:
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except binascii.Error:
        raise SignatureInvalid("the secret is not one of ours: it begins with whsec_") from None
    return base64.b64encode(hmac.digest(key, f"{delivery}.{at}.".encode() + body, hashlib.sha256)).decode()
