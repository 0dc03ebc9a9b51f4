// Foxglove's own client of its WebSocket protocol, and its own readers of ROS 2 messages.
//
//     foxglove.js URL SECONDS        in a folder with the packages of package.json
//
// Prints one JSON object: for each topic how many messages came, and one of them.
"use strict";
const load = require("node:module").createRequire(`${process.cwd()}/`);
const { FoxgloveClient } = load("@foxglove/ws-protocol");
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");
const WebSocket = load("ws");

const [url, seconds] = process.argv.slice(2);
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const topics = {};
const subscribed = new Map();
const complaints = [];
const plain = (_, value) => (typeof value === "bigint" ? Number(value) : ArrayBuffer.isView(value) ? Array.from(value) : value);

client.on("error", (error) => complaints.push(String(error)));
client.on("status", (status) => complaints.push(status.message));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    const reader = new MessageReader(parse(channel.schema, { ros2: true }));
    topics[channel.topic] = { type: channel.schemaName, count: 0, last: null };
    subscribed.set(client.subscribe(channel.id), [reader, topics[channel.topic]]);
  }
});
client.on("message", ({ subscriptionId, data }) => {
  const [reader, topic] = subscribed.get(subscriptionId);
  topic.last = reader.readMessage(data);
  topic.count += 1;
});
setTimeout(() => {
  client.close();
  process.stdout.write(`${JSON.stringify({ topics, complaints }, plain)}\n`, () => process.exit(0));
}, Number(seconds) * 1000);
