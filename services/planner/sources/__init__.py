"""Where samples come from: the API over HTTP, or a bundle in this process.

``samples`` is the port. ``sampling_client`` and ``async_sampling_client`` put the package ``cspace_client``,
which asks over HTTP, behind it, by ``client_errors``, ``client_source`` and ``found_plan``;
``local_sampler`` draws in this process.
"""
