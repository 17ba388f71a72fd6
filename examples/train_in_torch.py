"""A training loop of one's own: `python examples/train_in_torch.py DATASET`, made by `collect`."""

import sys

import torch

import tacgen

torch.manual_seed(0)
grasps = tacgen.Dataset(sys.argv[1]).torch(split="train")
loader = torch.utils.data.DataLoader(grasps, batch_size=8, shuffle=True)
network = torch.nn.Sequential(
    torch.nn.AvgPool2d(8), torch.nn.Flatten(), torch.nn.LazyLinear(32), torch.nn.ReLU(),
    torch.nn.Linear(32, 2),
)  # fmt: skip
network(next(iter(loader))[0])  # sizes the first layer
optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
for epoch in range(3):
    for images, labels in loader:
        loss = torch.nn.functional.cross_entropy(network(images), labels)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    print(f"epoch {epoch}: loss {loss.item():.3f} of the last batch")  # noqa: T201
