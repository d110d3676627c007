// SPDX-License-Identifier: Apache-2.0
import "./app.css";
import { App } from "./app";

new App().start();
