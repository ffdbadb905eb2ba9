//! The services with which others read and set parameters (`ros2 param`).

use crate::clock::{Clock, SIMULATED};
use crate::node::{RosNode, Service};
use ros2_client::parameters::{Parameter, ParameterDescriptor, ParameterValue, raw};
use ros2_client::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, ListParametersResult, SetParametersAtomicallyResponse,
    SetParametersRequest, SetParametersResponse,
};
use ros2_client::{Node, ServiceTypeName};
use std::future::ready;

/// The services.
pub struct ParameterServices {
    list: Service<ListParametersRequest, ListParametersResponse>,
    get: Service<GetParametersRequest, GetParametersResponse>,
    types: Service<GetParameterTypesRequest, GetParameterTypesResponse>,
    describe: Service<DescribeParametersRequest, DescribeParametersResponse>,
    set: Service<SetParametersRequest, SetParametersResponse>,
    set_atomically: Service<SetParametersRequest, SetParametersAtomicallyResponse>,
}

impl ParameterServices {
    /// Offers them.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode) -> anyhow::Result<Self> {
        let of = |name: &str| ServiceTypeName::new("rcl_interfaces", name);
        Ok(Self {
            list: node.service("list_parameters", &of("ListParameters"))?,
            get: node.service("get_parameters", &of("GetParameters"))?,
            types: node.service("get_parameter_types", &of("GetParameterTypes"))?,
            describe: node.service("describe_parameters", &of("DescribeParameters"))?,
            set: node.service("set_parameters", &of("SetParameters"))?,
            set_atomically: node
                .service("set_parameters_atomically", &of("SetParametersAtomically"))?,
        })
    }

    /// Answers what is asked of the parameters of a node; does not end.
    pub async fn serve(&self, node: &Node, clock: &Clock) {
        let value = |name: &String| node.get_parameter(name).unwrap_or(ParameterValue::NotSet);
        let set_one = |parameter| set_one(node, clock, parameter);
        let list = self.list.answer(|request| {
            let is_below = |name: &str, prefix: &str| {
                let rest = name.strip_prefix(prefix);
                rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            };
            let mut names = node.list_parameters();
            names.retain(|name| {
                let mut prefixes = request.prefixes.iter();
                request.prefixes.is_empty() || prefixes.any(|prefix| is_below(name, prefix))
            });
            let prefixes = Vec::new();
            let result = ListParametersResult { names, prefixes };
            ready(ListParametersResponse { result })
        });
        let get = self.get.answer(|request| {
            let values = request.names.iter().map(|name| value(name).into());
            ready(GetParametersResponse {
                values: values.collect(),
            })
        });
        let types = self.types.answer(|request| {
            let names = request.names.iter();
            let values = names.map(|name| ParameterValue::to_parameter_type_raw(&value(name)));
            ready(GetParameterTypesResponse {
                values: values.collect(),
            })
        });
        let describe = self.describe.answer(|request| {
            let describe = |name: &String| match node.get_parameter(name) {
                Some(value) => ParameterDescriptor::from_value(name, &value),
                None => ParameterDescriptor::unknown(name),
            };
            let values = request.names.iter().map(|name| describe(name).into());
            ready(DescribeParametersResponse {
                values: values.collect(),
            })
        });
        let set = self.set.answer(|request| {
            let parameters = request.parameter.into_iter();
            let results = parameters.map(|parameter| set_one(parameter).into());
            ready(SetParametersResponse {
                results: results.collect(),
            })
        });
        let set_atomically = self.set_atomically.answer(|request| {
            let parameters = request.parameter;
            let unknown = parameters.iter().find(|p| !node.has_parameter(&p.name));
            let result = match unknown {
                Some(parameter) => Err(format!("there is no parameter {}", parameter.name)),
                None => parameters.into_iter().try_for_each(set_one),
            };
            ready(SetParametersAtomicallyResponse {
                result: result.into(),
            })
        });
        futures::join!(list, get, types, describe, set, set_atomically);
    }
}

fn set_one(node: &Node, clock: &Clock, parameter: raw::Parameter) -> Result<(), String> {
    let Parameter { name, value } = parameter.into();
    node.set_parameter(&name, value)?;
    // the middleware tells nobody of this one
    if name == SIMULATED {
        clock.simulate(node.get_parameter(SIMULATED) == Some(ParameterValue::Boolean(true)));
    }
    Ok(())
}
