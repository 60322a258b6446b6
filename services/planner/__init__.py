"""Motion planning with OMPL, fed by configurations from the inference API.

samples.py -> sampling_client.py (async_sampling_client.py) fetch a batch over HTTP: http_exchange.py asks,
http_answer.py, npy_answer.py and npy_body.py read what comes, retries.py and deadline_transport.py keep to
the time; local_sampler.py draws it in this process; sample_mixture.py -> goal_region.py hand it to OMPL;
sampled_prm.py and sampled_connect.py draw from it themselves; ompl_planner.py solves; planning.py joins both;
plot.py draws what happened.
"""
