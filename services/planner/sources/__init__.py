"""Where samples come from: the API over HTTP, or a bundle in this process.

``samples`` is the port; ``sampling_client`` and ``async_sampling_client`` ask over HTTP and share
``http_client``: ``http_exchange`` words the request, ``http_answer``, ``npy_answer`` and ``npy_body`` read
what comes, ``retries`` and ``deadline_transport`` keep to the time; ``local_sampler`` draws in this process.
"""
