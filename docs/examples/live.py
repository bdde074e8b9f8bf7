from pathlib import Path

from tank import make

from fusion_sfdia import Watch, simulate
from fusion_sfdia.detectors import LeaveOneOutBank

plant, state = make(), Path("tank.state")
detector = LeaveOneOutBank(plant)
recording = simulate(plant, 120, seeds=[1])
y = recording.y[:, 0]
y[50:80, 1] += 0.1  # a bias of 0.1 m of level_2 for half an hour

watch = Watch.load(state, detector) if state.exists() else Watch(detector)
for change in watch.events(zip(recording.t, y, recording.u, strict=True)):
    if (event := change.event) is not None:  # none of a reset, nor of the model's health
        print(f"{change.what}: {event.hypothesis}, since {event.start:.0f} s, {event.fault or 'size'} {event.size:.2f} m")
watch.save(state)
