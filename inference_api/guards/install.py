"""The guards of an app, in order."""

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from inference_api.guards.authentication import Authentication
from inference_api.guards.body_limit import BodyLimit
from inference_api.guards.body_time import BodyTime
from inference_api.guards.concurrency import Concurrency
from inference_api.guards.doors import Doors
from inference_api.guards.protection import Protection
from inference_api.guards.rate import RateLimit, TokenBuckets
from inference_api.keys import ApiKeys, warn_of_readers


def add_guards(app: FastAPI, protection: Protection) -> None:
    """Put the guards before an app, the cheapest refusal last, that is first to be asked.

    Raises:
        ConfigError: the file of keys is not one.
    """
    app.add_middleware(BodyLimit, held_bytes=protection.held_body_bytes)
    app.add_middleware(BodyTime, limit_s=protection.body_timeout_s)
    app.add_middleware(Concurrency, limit=protection.max_in_flight)
    if protection.rate_per_s > 0:
        buckets = TokenBuckets(protection.rate_per_s, protection.rate_burst)
        app.add_middleware(RateLimit, buckets=buckets)
    if protection.keys_file is not None:
        app.add_middleware(Authentication, keys=ApiKeys.read(protection.keys_file))
        warn_of_readers(protection.keys_file)
    if protection.origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=protection.origins,
            allow_methods=["GET", "POST"],
            allow_headers=["*"],
            expose_headers=["*"],
        )
    app.add_middleware(Doors, hosts=protection.hosts, origins=protection.origins)
    if protection.trusted_proxies:
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(protection.trusted_proxies))
